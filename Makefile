PYTHON ?= python3
VENV ?= .venv
OUT ?= out/demo
BIN := $(VENV)/bin
PYTHONS ?= $(PYTHON)

.PHONY: demo test windows release lint blender clean

# Denoise, upscale and tone-map the sample sequence. Installs postfx without torch.
demo: $(VENV)/installed
	$(BIN)/postfx run samples/room/noisy.####.exr -o $(OUT)/clean.####.exr --overwrite
	$(BIN)/postfx run $(OUT)/clean.####.exr -o $(OUT)/picture.####.png --no-denoise --overwrite
	$(BIN)/python samples/before_after.py $(OUT)/before_after.png
	@echo "Look at $(OUT): before_after.png, picture.*.png (tone-mapped), clean.*.exr (scene-linear); all twice as large."

# Tests start a hundred processes: without kept bytecode each would compile all sources anew.
test: export PYTHONDONTWRITEBYTECODE =
test: $(VENV)/installed-dev
	$(BIN)/ruff check .
	$(BIN)/python -m pytest --numprocesses auto --maxprocesses 8 --dist loadfile --no-loadscope-reorder

# The extension for Blender 4.2 and later, to install by Preferences > Get Extensions > Install from Disk.
blender:
	@mkdir -p dist
	cd hosts/blender_postfx && $(PYTHON) -m zipfile -c ../../dist/postfx-blender.zip blender_manifest.toml __init__.py
	@echo dist/postfx-blender.zip

# The tests of files and of the command line, as if on Windows: without what only POSIX has.
windows: export PYTHONPATH = tests/windows
windows: $(VENV)/installed-dev
	$(BIN)/python -m pytest --numprocesses auto --maxprocesses 8 tests/files tests/io tests/cli tests/reliability

# Wheel and sdist in dist/, each installed and run in a fresh environment of every Python in PYTHONS.
release: $(VENV)/installed-dev
	rm -rf dist
	$(BIN)/python -m hatchling build -d dist
	for python in $(PYTHONS); do .ci/check_release $$python || exit 1; done

lint: $(VENV)/installed-dev
	$(BIN)/ruff check .
	$(BIN)/mypy

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/installed: pyproject.toml | $(BIN)/python
	$(BIN)/pip install --quiet -e .
	@touch $@

$(VENV)/installed-dev: pyproject.toml constraints.txt | $(BIN)/python
	$(BIN)/pip install --quiet -c constraints.txt -e '.[dev]'
	@touch $@

clean:
	rm -rf $(VENV) out build dist
