"""The command line, thin: parse, call, print. Here is how a command ends; `app` lists the commands."""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Sequence

from drake_hand.cli import interrupt
from drake_hand.errors import INTERRUPTED

_GARBAGE_THRESHOLDS = 100_000, 20, 10
"""Of the garbage collector: imports and plans are many objects that stay, and a command spent a tenth of its time
looking through them."""


def run(tokens: Sequence[str]) -> int:
    """Runs a command; returns its exit status. Errors become one message and the status of their kind."""
    try:
        return _run(tokens)
    except KeyboardInterrupt as e:
        return _interrupted(str(e))
    except Exception:
        if interrupt.heard():  # compiled code that was interrupted raises what it likes
            return _interrupted()
        raise


def _interrupted(words: str = "") -> int:
    interrupt.ignore()
    print(f"drake-hand: {words or 'interrupted'}", file=sys.stderr)
    return INTERRUPTED


def _run(tokens: Sequence[str]) -> int:
    from cyclopts import CycloptsError

    from drake_hand.cli.app import build_app, usage_error
    from drake_hand.cli.output import TRACEBACK, report_error
    from drake_hand.errors import DrakeHandError, InputError

    as_json = "--json" in tokens
    if sys.getfilesystemencoding() != "utf-8":  # in which Drake cannot even be imported
        found = sys.getfilesystemencoding()
        return report_error(InputError(f"Drake needs UTF-8, this locale is {found}; set LC_ALL=C.UTF-8"), as_json)
    try:
        result = build_app(tokens)(list(tokens), exit_on_error=False, print_error=False, result_action="return_value")
        sys.stdout.flush()
        return result if isinstance(result, int) else 0
    except DrakeHandError as e:
        return report_error(e, as_json)
    except CycloptsError as e:
        return report_error(usage_error(e), as_json)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # the reader has gone; let exit flush in peace
        return 141
    except FileExistsError as e:
        wrong = InputError("this is a file", file=e.filename, found="a file", expected="the name of a folder")
        return report_error(wrong, as_json)
    except OSError as e:
        return report_error(InputError(f"cannot use file: {e.strerror or e}", file=e.filename), as_json)
    except UnicodeEncodeError as e:
        return report_error(InputError(f"the output takes only {e.encoding}; set PYTHONIOENCODING=utf-8"), as_json)
    except Exception as e:
        if os.environ.get(TRACEBACK) or interrupt.heard():
            raise
        bug = DrakeHandError(f"unexpected {type(e).__name__}: {e} (set {TRACEBACK}=1 to see where)")
        return report_error(bug, as_json)


def main() -> None:
    """Entry point of ``drake-hand``."""
    interrupt.heed()
    gc.set_threshold(*_GARBAGE_THRESHOLDS)
    status = run(sys.argv[1:])
    gc.freeze()  # half a second in which a process that ends anyway would look for garbage
    sys.exit(status)
