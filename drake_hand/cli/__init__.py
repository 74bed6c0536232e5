"""The command line, thin: parse, call, print. Command modules load only when their command runs."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

from cyclopts import App, CycloptsError, MissingArgumentError, Parameter
from cyclopts.exceptions import UnknownCommandError

from drake_hand import __version__
from drake_hand.cli.arguments import choices, command_for, exact, offer
from drake_hand.cli.output import TRACEBACK, report_error
from drake_hand.errors import DrakeHandError, InputError, nearest

COMMANDS = {
    "demo": ("drake_hand.cli.demo:demo", "Plan, check, simulate and execute the bundled pencil rotation."),
    "plan": ("drake_hand.cli.plans:plan", "Find a certified plan for a task."),
    "check": ("drake_hand.cli.plans:check", "Certify a plan again, from its file alone."),
    "simulate": ("drake_hand.cli.simulate:simulate", "Replay a plan in physics."),
    "show": ("drake_hand.cli.show:show", "Watch a plan in the browser."),
    "plot": ("drake_hand.cli.plot:plot", "Draw a plan, or the record of a run, as figures."),
    "export": ("drake_hand.cli.export:export", "Export a plan for other controllers: CSV, npz, ROS 2."),
    "execute": ("drake_hand.cli.drives_execute:execute", "Play a plan on motor drives, real or simulated."),
    "drives": ("drake_hand.cli.drives:app", "Scan, inspect, power off, move and simulate drives."),
    "mirror": ("drake_hand.cli.mirror:mirror", "Show the commanded and the measured hand, live."),
    "modes": ("drake_hand.cli.modes:modes", "Explain a mode, or list the automaton."),
    "hand": ("drake_hand.cli.hand:app", "Check, draft or convert a hand model."),
    "sweep": ("drake_hand.cli.sweep:sweep", "Plan, certify and replay a grid of tasks, on all cores or a cluster."),
    "bench": ("drake_hand.cli.bench:bench", "Measure speed on this machine."),
}
"""Name: (where it is, its line in ``drake-hand --help``)."""


def build_app(tokens: Sequence[str]) -> App:
    """The app for these tokens: a command that is named shows its own docstring, the others the line of the table."""
    app = App(
        name="drake-hand",
        version=__version__,
        help="Plan, certify, show and execute finger gaits of dexterous hands.",
        help_format="markdown",
        default_parameter=Parameter(negative="", converter=exact, completer=offer),
        suppress_keyboard_interrupt=False,
    )
    for name, (target, summary) in COMMANDS.items():
        app.command(
            target, name=name, help=None if name in tokens[:1] else summary, sort_key=list(COMMANDS).index(name)
        )
    app.register_install_completion_command(help="Install completion for this shell.")
    return app


def run(tokens: Sequence[str]) -> int:
    """Runs a command; returns its exit status. Errors become one message and the status of their kind."""
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
        return report_error(_usage_error(e), as_json)
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
    except KeyboardInterrupt as e:
        print(f"drake-hand: {str(e) or 'interrupted'}", file=sys.stderr)
        return 130
    except Exception as e:
        if os.environ.get(TRACEBACK):
            raise
        bug = DrakeHandError(f"unexpected {type(e).__name__}: {e} (set {TRACEBACK}=1 to see where)")
        return report_error(bug, as_json)


def _usage_error(e: CycloptsError) -> InputError:
    """What is wrong with the arguments, in one message."""
    if isinstance(e, UnknownCommandError) and e.unused_tokens:
        word, known = e.unused_tokens[0], [n for n in e.app or () if not n.startswith("-")] if e.app else list(COMMANDS)
        command = None if e.command_chain else command_for(word)
        expected = f"did you mean '{command} {word}'?" if command else nearest(word, known)
        return InputError(f"unknown command '{word}'", found=word, expected=expected)
    missing = e.argument.field_info.name if isinstance(e, MissingArgumentError) and e.argument else ""
    return InputError(" ".join(str(e).split()), expected=choices(missing))


def main() -> None:
    """Entry point of ``drake-hand``."""
    sys.exit(run(sys.argv[1:]))
