PY := .venv/bin/python
.PHONY: install
.venv/.installed: pyproject.toml constraints.txt
	python3.11 -m venv .venv
	$(PY) -m pip install --quiet --upgrade pip
	$(PY) -m pip install --quiet -c constraints.txt -e '.[dev]'
	touch $@
install: .venv/.installed
