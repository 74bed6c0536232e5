"""`njit`: numba's, with machine code kept wherever there is a place to keep it, so that a machine compiles once.

``python -m drake_hand.compiled`` compiles everything there is. Done once where the package is installed, it leaves
nothing to compile to anyone who uses it, also where they may write nowhere. A wheel built afterwards brings the code
along.
"""

from __future__ import annotations

import hashlib
import importlib
import logging
import os
import shutil
import stat
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numba
from llvmlite import binding as llvm
from numba.core import event

PACKAGE = Path(__file__).parent

_LEVEL = "x86-64-v3"
"""Processors that code is compiled for: any since 2013 or so, so that what one machine compiled, others use."""
_LEVEL_FEATURES = ("avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe")
"""What those of `_LEVEL` have; where one is missing, code is for the processor at hand."""


def _compile_for_level() -> None:
    """Tells numba, for whatever this process compiles; where nobody told it for what processor to compile."""
    config: Any = numba.config
    if config.CPU_NAME is None and all(llvm.get_host_cpu_features().get(x) for x in _LEVEL_FEATURES):
        config.CPU_NAME, config.CPU_FEATURES = _LEVEL, ""


_compile_for_level()


def njit(
    signature: str | tuple[Any, ...] | None = None, *, allocates: bool = False, inline: bool = False
) -> Callable[[Callable], Any]:
    """Compiles a function for numpy arrays and numbers: no Python objects, no GIL, division as in numpy.

    A kernel called from Python states its signature, in numba's notation or as types: it is compiled, or loaded, on
    import, takes C-contiguous writable arrays of just these types, and is among what `prepare` compiles. Functions that
    only kernels call state none, and stand before them. They count no references to arrays, which they are lent:
    counting took four fifths of a stroke's time, more where two cores count the same. So they make and return none.

    ```python
    @njit("f8[:](f8[:, ::1], f8)")
    def _lengths(p, scale): ...
    ```

    Code is kept beside the source, else in the user's cache directory, else in one of the user's own below the
    temporary directory, else in memory. What was compiled beside the source is used wherever new code is kept. Kernels
    are compiled into those that call them, across files, so that kept code holds as long as no kernel's file changes.

    Args:
        signature: of the only version there is; without one, a version is compiled for every kind of arguments.
        allocates: that a function without one makes arrays all the same.
        inline: compiled into its callers in any case: for short functions of whole scenes, whose arrays would else be
            handed over one by one.
    """
    options: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
    if signature is None and not allocates:
        options["_nrt"] = False
    if inline:
        options["forceinline"] = True

    def compile_(function: Callable) -> Any:
        kernel = numba.njit(**options)(function)
        if "_nrt" in options:
            _LENT.append(kernel)
        if _keep(kernel):
            index: Any = getattr(kernel, "_cache")._cache_file  # noqa: B009
            # in place of the file's time and size, which every copy changes
            index._version, index._source_stamp = f"{numba.__version__} {_sources()[1]}", None
            _copy_ready(kernel)
        if signature is not None:
            with event.install_listener("numba:compile", _Told()):
                kernel.compile(signature)
            _see_that_lent_arrays_stay()
            kernel.disable_compile()
        return kernel

    return compile_


_LENT: list[Any] = []
"""Functions that count no references."""


def _see_that_lent_arrays_stay() -> None:
    """Nothing that counts no references may hand an array to what does: numba itself only sees that none is made."""
    for kernel in _LENT:
        for version in kernel.overloads.values():
            returned = version.signature.return_type
            if any(isinstance(x, numba.types.Array) for x in getattr(returned, "types", [returned])):
                raise TypeError(f"{kernel.py_func.__qualname__} returns an array, but not with allocates=True")


class _Told(event.Listener):
    """Says, the first time that there is no code yet, why nothing else happens for minutes."""

    def on_start(self, event: Any) -> None:
        _say()

    def on_end(self, event: Any) -> None:
        pass


@cache
def _say() -> None:
    logging.getLogger(__name__).warning(
        "compiling kernels, once on this machine: some minutes (python -m drake_hand.compiled does it beforehand)"
    )


def prepare() -> list[str]:
    """Compiles the kernels of all modules, or finds them compiled.

    Returns:
        The modules that have some.
    """
    modules = [".".join(f.relative_to(PACKAGE.parent).with_suffix("").parts) for f in _sources()[0]]
    for module in modules:
        importlib.import_module(module)
    return modules


@cache
def _sources() -> tuple[list[Path], str]:
    """The files with kernels in them, and a digest of all."""
    texts = {file: file.read_bytes() for file in sorted(PACKAGE.rglob("*.py"))}
    texts = {file: text for file, text in texts.items() if b"\nfrom drake_hand.compiled import" in text}
    return list(texts), hashlib.sha256(b"\0".join(texts.values())).hexdigest()


def _keep(kernel: Any) -> bool:
    """Lets numba keep the kernel's code on disk, if there is a place; says whether there is."""
    try:
        kernel.enable_caching()
        return True
    except RuntimeError:  # neither beside the source nor in a home directory
        folder = _temporary()
    if folder is None:
        return False
    config: Any = numba.config
    before, config.CACHE_DIR = config.CACHE_DIR, str(folder)
    try:
        kernel.enable_caching()
    finally:
        config.CACHE_DIR = before
    return True


def _temporary() -> Path | None:
    """A folder below the temporary directory into which nobody else can put code."""
    try:
        folder = Path(tempfile.gettempdir()) / f"drake_hand-{os.getuid()}"
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError:
        return None
    own = stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not found.st_mode & 0o077
    return folder if own else None


def _copy_ready(kernel: Any) -> None:
    """Copies code from beside the source to where the kernel's is kept; numba takes none that is out of date."""
    source, kept = Path(kernel.py_func.__code__.co_filename), Path(kernel.stats.cache_path)
    # code comes before the index that points to it
    ready = sorted((source.parent / "__pycache__").glob(f"{source.stem}.{kernel.py_func.__qualname__}-*.nb[ci]"))
    if not ready or kept == ready[0].parent:
        return
    index = kept / ready[-1].name
    if index.exists() and index.stat().st_mtime >= ready[-1].stat().st_mtime:
        return
    for file in ready:
        part = kept / f".{os.getpid()}.{file.name}"
        shutil.copyfile(file, part)
        os.replace(part, kept / file.name)


if __name__ == "__main__":
    logging.disable()
    for name in prepare():
        print(f"compiled {name}")
