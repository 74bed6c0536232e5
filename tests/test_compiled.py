"""Kernels where the package may not be written, by a user without a home: ready, kept elsewhere, or in memory."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import drake_hand

KERNEL = '''"""A kernel."""
from drake_hand.compiled import njit

@njit()
def _square(x):
    return x * x

@njit("f8(f8)")
def length(x):
    return _square(x) ** 0.5
'''
PARTS = '''"""What a kernel of another file is made of."""
from typing import NamedTuple

from drake_hand.compiled import njit

class Pair(NamedTuple):
    x: float
    y: float

@njit()
def half(p):
    return p.x / 2.0
'''
ASK = """
import drake_hand.kernel as k
assert k.length(-3.0) == 3.0
stats = getattr(k.length, "stats")
print(sum(stats.cache_hits.values()), stats.cache_path)
"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package of `njit` and one kernel, in a folder of its own."""
    folder = tmp_path / "installed" / "drake_hand"
    folder.mkdir(parents=True)
    source = Path(drake_hand.__file__).parent
    for name in ("__init__.py", "errors.py", "compiled.py"):
        shutil.copy(source / name, folder)
    (folder / "kernel.py").write_text(KERNEL)
    return folder


def read_only(package: Path) -> None:
    for path in [package, *package.rglob("*")]:
        path.chmod(path.stat().st_mode & 0o555)


def ask(package: Path, tmp: Path, code: str = ASK) -> list[str]:
    """What a process says that runs with the rights of files as they are, even if the tests are run by root."""
    plain = ["setpriv", "--bounding-set=-all", "--inh-caps=-all"] if os.getuid() == 0 else []
    environment = {"PYTHONPATH": str(package.parent), "HOME": os.devnull, "TMPDIR": str(tmp), "PATH": os.defpath}
    command = [*plain, sys.executable, "-c", code]
    job = subprocess.run(command, env=environment, cwd=package.parent.parent, capture_output=True, text=True)
    assert job.returncode == 0, job.stderr
    if code == ASK:  # whoever waits for minutes is told why, and nobody else
        assert job.stderr.count("compiling kernels, once on this machine") == (job.stdout.split()[0] == "0")
    return job.stdout.split()


def test_code_is_kept_beside_the_source(package, tmp_path):
    assert ask(package, tmp_path) == ["0", str(package / "__pycache__")]
    assert ask(package, tmp_path) == ["1", str(package / "__pycache__")]


LENT = """
import numpy as np
from drake_hand.compiled import njit

@njit()
def _row(x):
    return x[0]

@njit("f8(f8[:, ::1])")
def first(x):
    return _row(x)[0]
"""


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("", ""), "Only accept returning of array passed into the function"),
        (("return x[0]", "return 1.0, x[0]"), "TypeError: _row returns an array, but not with allocates=True"),
        (("return x[0]", "return x[0] + np.ones(x.shape[1])"), "Failed in nopython mode"),
    ],
)
def test_functions_that_count_no_references_neither_make_nor_return_arrays(package, tmp_path, change, says):
    source = LENT.replace(*change).replace("_row(x)[0]", "_row(x)[1][0]" if "1.0," in change[1] else "_row(x)[0]")
    (package / "kernel.py").write_text(source)
    with pytest.raises(AssertionError, match=says):
        ask(package, tmp_path, "import drake_hand.kernel")
    (package / "kernel.py").write_text(source.replace("@njit()", "@njit(allocates=True)"))
    ask(package, tmp_path, "import drake_hand.kernel")


def test_code_is_taken_along_when_the_package_is_copied(package, tmp_path):
    """As a wheel does: files get other times, and another place."""
    assert ask(package, tmp_path)[0] == "0"
    copy = tmp_path / "elsewhere" / "drake_hand"
    shutil.copytree(package, copy, copy_function=shutil.copy)
    os.utime(copy / "kernel.py", (0, 0))
    shutil.rmtree(package)
    assert ask(copy, tmp_path) == ["1", str(copy / "__pycache__")]


def test_code_is_not_for_this_processor_alone(package, tmp_path):
    code = "import drake_hand.kernel as k; from numba.core.registry import cpu_target as t"
    triple, processor, features = ask(
        package, tmp_path, f"{code}; print(*t.target_context.codegen().magic_tuple(), '-')"
    )[:3]
    if triple.startswith("x86_64"):
        assert (processor, features) == ("x86-64-v3", "-")


def test_code_is_compiled_anew_where_a_kernel_of_another_file_has_changed(package, tmp_path):
    """Numba itself looks at a kernel's own file alone, and cannot even read what it kept of types that have moved."""
    (package / "parts.py").write_text(PARTS)
    kernel = KERNEL.replace("import njit\n", "import njit\nfrom drake_hand.parts import Pair, half\n")
    (package / "kernel.py").write_text(kernel.replace("x * x", "half(Pair(x, 0.0)) * 2.0 * x"))
    assert ask(package, tmp_path)[0] == "0"
    assert ask(package, tmp_path)[0] == "1"
    (package / "parts.py").write_text(PARTS.replace("p.x / 2.0", "p.x / 8.0"))
    assert ask(package, tmp_path, ASK.replace("== 3.0", "== 1.5"))[0] == "0"


def test_code_is_kept_in_a_private_folder_where_there_is_no_home(package, tmp_path):
    read_only(package)
    hits, folder = ask(package, tmp_path)
    assert hits == "0"
    own = tmp_path / f"drake_hand-{os.getuid()}"
    assert own in Path(folder).parents
    assert own.stat().st_mode & 0o077 == 0
    assert ask(package, tmp_path) == ["1", folder]


def test_what_the_installation_compiled_serves_those_who_may_not_write(package, tmp_path):
    prepared = ask(package, tmp_path, "import drake_hand.compiled as c; print(*c.prepare())")
    assert prepared == ["drake_hand.kernel"]
    read_only(package)
    assert ask(package, tmp_path)[0] == "1"


def test_code_stays_in_memory_where_nothing_may_be_written_or_trusted(package, tmp_path):
    read_only(package)
    shared = tmp_path / f"drake_hand-{os.getuid()}"
    shared.mkdir()
    shared.chmod(0o777)
    assert ask(package, tmp_path) == ["0", "None"]
    assert not list(shared.iterdir())
