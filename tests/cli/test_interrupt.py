"""Ctrl-C: 130 and one line, whatever it interrupts and however often it is pressed."""

import subprocess
import sys
from pathlib import Path

import pytest

LIBRARY = """
import os, signal
try:
    os.kill(os.getpid(), signal.SIGINT)
    import json
except BaseException:
    json = None
"""
HEAD = """
import os, signal, sys, time
from types import SimpleNamespace
from drake_hand import cli
from drake_hand.cli import app, interrupt, output
def ctrl_c():
    os.kill(os.getpid(), signal.SIGINT)
def command():
{body}
sys.modules["probe"] = SimpleNamespace(command=command)
app.COMMANDS["probe"] = ("probe:command", "for tests")
sys.argv = ["drake-hand", "probe"]
cli.main()
"""


def probe(body: str, folder: Path) -> subprocess.CompletedProcess:
    """Runs `drake-hand probe`, whose command is `body`."""
    code = HEAD.format(body="".join(f"    {line}\n" for line in body.strip().splitlines()))
    return subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, timeout=60)


BODIES = {
    "once": "ctrl_c()",
    "while cleaning up": """
try:
    ctrl_c()
finally:
    ctrl_c(); ctrl_c(); print('cleaned up')
""",
    "disguised": """
try:
    ctrl_c()
except BaseException:
    raise ImportError('initialization failed')
""",
    "swallowed": """
try:
    ctrl_c()
except BaseException:
    pass
from dataclasses import make_dataclass
with output.progress_display(quiet=True) as tell:
    tell(make_dataclass('Progress', ['stage', 'fraction'])('search', 0.5))
""",
    "in a destructor": """
class Gone:
    def __del__(self):
        ctrl_c()
Gone()
interrupt.insist()
""",
    "at exit": """
import atexit
atexit.register(lambda: (time.sleep(1.1), ctrl_c()))
ctrl_c()
""",
}


@pytest.mark.parametrize("body", BODIES.values(), ids=list(BODIES))
def test_interrupt_is_one_line_and_130(body, tmp_path):
    done = probe(body, tmp_path)
    assert done.returncode == 130
    assert done.stderr == "drake-hand: interrupted\n"
    assert ("cleaned up" in done.stdout) == ("cleaned up" in body)


def test_what_is_imported_is_imported_whole(tmp_path):
    """Trimesh takes any exception while it imports for a missing library, and goes on without."""
    (tmp_path / "library.py").write_text(LIBRARY)
    body = "try:\n    import library\n    time.sleep(10)\nfinally:\n    print(library.json.__name__)"
    done = probe(body, tmp_path)
    assert (done.returncode, done.stdout) == (130, "json\n")


def test_interrupt_before_the_command_is_known_is_one_line_too():
    code = "import os, signal, sys\nfrom drake_hand import cli\nsys.argv = ['drake-hand', 'check', 'x']\n"
    code += "class Early:\n    def find_spec(self, name, *_):\n        if name == 'drake_hand.cli.app':\n"
    code += "            os.kill(os.getpid(), signal.SIGINT)\nsys.meta_path.insert(0, Early())\ncli.main()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (130, "drake-hand: interrupted\n")
