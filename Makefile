PYTHON ?= python3
VENV ?= .venv
OUT ?= out/demo
BIN := $(VENV)/bin
PYTHONS ?= $(PYTHON)
TARGETS ?= linux-x86_64 linux-aarch64 macos-arm64 macos-x86_64 windows-x86_64
ORT := build/npm/node_modules/onnxruntime-web/dist
THREE := build/npm/node_modules/three

.PHONY: demo test windows docs page release lint blender clean

# The sample sequence: pictures, a video and a page that shows them. Installs postfx without torch.
demo:
	@test -e $(VENV)/installed || echo "1 of 4  install into $(VENV) and compile kernels: one to three minutes ..."
	@$(MAKE) --no-print-directory $(VENV)/installed
	@$(BIN)/python samples/demo.py $(OUT)

# Tests start a hundred processes: without kept bytecode each would compile all sources anew.
test: export PYTHONDONTWRITEBYTECODE =
test: $(VENV)/installed-dev
	$(BIN)/ruff check .
	$(BIN)/python -m pytest --numprocesses auto --maxprocesses 8 --dist loadfile --no-loadscope-reorder

# The documentation site, in build/site: from docs/, the code and, if npm is there, the page in the browser.
docs: $(VENV)/installed-docs
	$(BIN)/python -m pytest -q tests/test_words.py tests/test_site.py tests/test_search.py
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --strict
	if command -v npm >/dev/null; then \
	    $(MAKE) page && $(BIN)/python -m pytest -q tests/web && cp -r build/page build/site/try; fi
	@echo "build/site/index.html"

# The page in the browser, in build/page: static files only. ONNX Runtime Web and three.js come from the npm registry.
page: $(VENV)/installed-docs
	rm -rf build/page
	mkdir -p build/npm build/page/ort build/page/three/loaders build/page/three/libs
	cp web/package.json build/npm && cd build/npm && npm install --silent --no-audit --no-fund --ignore-scripts
	$(BIN)/python web/export.py build/page/models
	cp web/*.html web/*.css web/*.js docs/logo.svg build/page
	cp samples/room/noisy.0006.exr build/page/sample.exr
	cp $(ORT)/ort.wasm.min.mjs $(ORT)/ort.webgpu.min.mjs $(ORT)/ort-wasm-simd-threaded.mjs \
	    $(ORT)/ort-wasm-simd-threaded.wasm $(ORT)/ort-wasm-simd-threaded.asyncify.* build/page/ort
	cp $(THREE)/build/three.core.js $(THREE)/LICENSE build/page/three
	cp $(THREE)/examples/jsm/loaders/EXRLoader.js build/page/three/loaders
	cp $(THREE)/examples/jsm/libs/fflate.module.js build/page/three/libs
	@echo "build/page: serve it with 'python3 -m http.server -d build/page'"

# The extension for Blender 4.2 and later, to install by Preferences > Get Extensions > Install from Disk.
blender:
	@mkdir -p dist
	cd hosts/blender_postfx && $(PYTHON) -m zipfile -c ../../dist/postfx-blender.zip blender_manifest.toml __init__.py LICENSE
	@echo dist/postfx-blender.zip

# The tests of files and of the command line, as if on Windows: without what only POSIX has.
windows: export PYTHONPATH = tests/windows
windows: $(VENV)/installed-dev
	$(BIN)/python -m pytest --numprocesses auto --maxprocesses 8 tests/files tests/io tests/cli tests/reliability

# Wheels and sdist in dist/, conda-forge's recipe in build/recipe.yaml; needs no PyTorch. This machine's wheel, if it is
# among the TARGETS, and the sdist are installed and run in a fresh environment of every Python in PYTHONS. The kernels of
# all targets are compiled here; the first time, Windows takes some minutes.
release: $(VENV)/installed-release
	rm -rf dist
	for target in $(TARGETS); do POSTFX_TARGET=$$target $(BIN)/python -m hatchling build -t wheel -d dist || exit 1; done
	$(BIN)/python -m hatchling build -t sdist -d dist
	$(BIN)/python packaging/conda_recipe.py dist/postfx_render-*.tar.gz build/recipe.yaml
	for python in $(PYTHONS); do .ci/check_release $$python || exit 1; done

$(VENV)/installed-release: pyproject.toml constraints.txt | $(BIN)/python
	$(BIN)/pip install --quiet -c constraints.txt -e '.[release]'
	@touch $@

$(VENV)/installed-docs: pyproject.toml constraints.txt | $(BIN)/python
	$(BIN)/pip install --quiet -c constraints.txt -e '.[docs]'
	@touch $@

lint: $(VENV)/installed-dev
	$(BIN)/ruff check .
	$(BIN)/mypy

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/installed: pyproject.toml | $(BIN)/python
	$(BIN)/pip install --quiet -e .
	@touch $@

# 13,000 modules are installed, and a third is ever imported: Python compiles those at their first use.
$(VENV)/installed-dev: pyproject.toml constraints.txt | $(BIN)/python
	$(BIN)/pip install --quiet --no-compile -c constraints.txt -e '.[dev]'
	@touch $@

clean:
	rm -rf $(VENV) out build dist
