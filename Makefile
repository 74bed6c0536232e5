# The whole developer interface. Every target first builds .venv from a bare python3.11.
PY := .venv/bin/python

.PHONY: install demo test test-slow bench lint wheel clean
install: .venv/.installed

.venv/.installed: pyproject.toml constraints.txt
	python3.11 -m venv .venv
	$(PY) -m pip install --quiet -c constraints.txt -e '.[dev]'
	$(PY) -m drake_hand.compiled
	touch $@

demo: install
	.venv/bin/drake-hand demo

# Whole modules go to one process where possible, so that what their tests share is made once. What runs on the bus
# keeps time, and must not share the machine with other tests.
test: install
	$(PY) -m pytest -n 2 --dist worksteal -m "not (clocked or slow or benchmark)"
	$(PY) -m pytest -m "clocked and not (slow or benchmark)"

test-slow: install
	$(PY) -m pytest -n 2 --dist worksteal -m "slow and not clocked"
	$(PY) -m pytest -m "slow and clocked"

bench: install
	$(PY) -m pip install --quiet -c constraints.txt -e '.[dev,bench]'
	.venv/bin/drake-hand bench

lint: install
	.venv/bin/ruff check
	.venv/bin/ruff format --check
	.venv/bin/mypy

# With the kernels' machine code in it: whoever installs it compiles nothing.
wheel: install
	$(PY) -m build --wheel --no-isolation

clean:
	rm -rf .venv out dist build
