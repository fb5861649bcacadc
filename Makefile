PYTHON ?= python3
VENV ?= .venv
OUT ?= out/demo
BIN := $(VENV)/bin

.PHONY: demo test lint clean

# Denoise, upscale and tone-map the sample sequence. Installs postfx without torch.
demo: $(VENV)/installed
	$(BIN)/postfx run samples/room/noisy.####.exr -o $(OUT)/clean.####.exr --overwrite
	$(BIN)/postfx run $(OUT)/clean.####.exr -o $(OUT)/picture.####.png --no-denoise --overwrite
	@echo "Look at $(OUT): clean.*.exr is scene-linear and twice as large, picture.*.png is tone-mapped."

test: $(VENV)/installed-dev
	$(BIN)/ruff check .
	$(BIN)/python -m pytest

lint: $(VENV)/installed-dev
	$(BIN)/ruff check .

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
