"""The commands there are. Their modules load only when their command runs."""

from __future__ import annotations

from collections.abc import Sequence

from cyclopts import App, CycloptsError, MissingArgumentError, Parameter
from cyclopts.exceptions import UnknownCommandError

from drake_hand import __version__
from drake_hand.cli.arguments import choices, command_for, exact, offer
from drake_hand.errors import InputError, nearest

COMMANDS = {
    "demo": ("drake_hand.cli.demo:demo", "Plan, check, simulate and execute the bundled pencil rotation."),
    "plan": ("drake_hand.cli.plans:plan", "Find a certified plan for a task."),
    "check": ("drake_hand.cli.plans:check", "Certify a plan again, from its file alone."),
    "simulate": ("drake_hand.cli.simulate:simulate", "Replay a plan in physics."),
    "growth": ("drake_hand.cli.growth:growth", "Predict and simulate how an error at the start propagates."),
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


def usage_error(e: CycloptsError) -> InputError:
    """What is wrong with the arguments, in one message."""
    if isinstance(e, UnknownCommandError) and e.unused_tokens:
        word, known = e.unused_tokens[0], [n for n in e.app or () if not n.startswith("-")] if e.app else list(COMMANDS)
        command = None if e.command_chain else command_for(word)
        expected = f"did you mean '{command} {word}'?" if command else nearest(word, known)
        return InputError(f"unknown command '{word}'", found=word, expected=expected)
    missing = e.argument.field_info.name if isinstance(e, MissingArgumentError) and e.argument else ""
    return InputError(" ".join(str(e).split()), expected=choices(missing))
