"""`drake-hand modes`: explains a mode, lists and draws the automaton, or judges a plan by its predicates."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from drake_hand.cli.modes_plan import judge_plan
from drake_hand.cli.output import print_json, print_table
from drake_hand.contact.submodel import JointCount, finger_mechanism, hand_mechanism
from drake_hand.files import load, resolve
from drake_hand.model.hand import HAND_SUFFIX, Hand, HandSpec
from drake_hand.model.xml import read_xml
from drake_hand.modes.automaton import Automaton
from drake_hand.modes.code import Mode, contact_counts, listed


def modes(
    code: str | None = None,
    /,
    *,
    hand: Annotated[str, Parameter(help="Bundled hand or path of a hand.yaml.")] = "kanguera",
    plan: Annotated[Path | None, Parameter(help="Evaluate the predicates along this plan file.")] = None,
    graph: Annotated[Path | None, Parameter(help="Draw all modes into this .svg, .png or .pdf.")] = None,
    json: Annotated[bool, Parameter(help="Print one JSON object.")] = False,
) -> int:
    """Explain a mode, or list the hybrid automaton.

    A mode code has a digit per finger, little finger first, thumb last: 0 free, 1 rolling, 2 sliding. 00111 is
    three fingers rolling. With --graph and a code, the switches of that mode are drawn strong.

    With --plan, init, inv, contact and jump are evaluated along a plan, of one mode or of all that it visits: for every
    clause its worst value, and where; and the modes' constraint sets wherever one begins or ends. Exit status: 0 all
    hold, 1 one does not, 2 invalid input.

    ```console
    $ drake-hand modes 00111
    $ drake-hand modes 11111 --plan spin.plan.json
    $ drake-hand modes --graph modes.svg
    ```
    """
    if plan is not None:
        return judge_plan(plan, code, json=json)
    automaton, joints = _outline(hand)
    mode = None if code is None else automaton.mode(code)
    answer = _describe(automaton, joints, hand) if mode is None else _explain(mode, automaton, joints, hand)
    if graph is not None:
        from drake_hand.modes.graph import draw

        title = f"The {3 ** len(automaton.fingers)} modes of {hand}"
        draw(graph, automaton.fingers, title=title, highlight=mode)
        answer["graph"] = str(graph)
    if json:
        print_json(answer)
    elif mode is None:
        _print_automaton(answer, automaton)
    else:
        _print_mode(answer, automaton, mode)
    return 0
    if graph is not None and not json:
        print(f"\ndrawn: {graph}")


def _describe(automaton: Automaton, joints: list[JointCount], hand: str) -> dict[str, Any]:
    counts = contact_counts(len(automaton.fingers))
    return {
        "hand": hand,
        "fingers": list(automaton.fingers),
        "modes": sum(counts),
        "modes_by_contacts": counts,
        "switches": automaton.switch_count(),
        "switches_one_finger": automaton.switch_count(at_once=1),
        "events": [str(e) for e in automaton.events],
        "variables": list(automaton.variables),
        "axes": [j.axes for j in joints],
        "couplings": [j.couplings for j in joints],
    }


def _explain(mode: Mode, automaton: Automaton, joints: list[JointCount], hand: str) -> dict[str, Any]:
    fingers = []
    for name, count, submodel in zip(automaton.fingers, joints, mode.submodels, strict=True):
        chain = finger_mechanism(count, submodel)
        numbers = {k: getattr(chain, k) for k in ("dof", "commanded_dof", "joints", "bodies", "loops")}
        fingers.append({"finger": name, "submodel": submodel.name, **numbers, "constraint": submodel.constraint})
    whole = hand_mechanism(joints, mode.submodels)
    return {
        "hand": hand,
        "mode": mode.code,
        "words": mode.words(automaton.fingers),
        "contacts": len(mode.touching),
        "fingers": fingers,
        "dof": whole.dof,
        "commanded_dof": whole.commanded_dof,
        "joints": whole.joints,
        "bodies": whole.bodies,
        "loops": whole.loops,
        "init": [str(c) for c in automaton.init(mode).clauses],
        "inv": [str(c) for c in automaton.inv(mode).clauses],
        "contact": [str(c) for c in automaton.contact(mode).clauses],
        "switches": [{"event": str(s.events[0]), "mode": s.after.code} for s in automaton.switches(mode)],
    }


def _print_automaton(answer: dict[str, Any], automaton: Automaton) -> None:
    n = len(automaton.fingers)
    rows = []
    for k, count in enumerate(answer["modes_by_contacts"]):
        rolling, sliding = ("0" * (n - k) + digit * k for digit in "12")
        rows.append([k, count, f"{rolling} ... {sliding}" if k else rolling])
    print_table(f"{answer['hand']}: {answer['modes']} modes", ["in contact>", "modes>", "such as"], rows)
    kinds = list(dict.fromkeys(e.kind for e in automaton.events))
    print(
        f"V  {answer['modes']} modes: 0 free, 1 rolling, 2 sliding for each of {listed(automaton.fingers)}",
        f"E  {answer['switches']} switches, {answer['switches_one_finger']} of them with one finger changing",
        f"   events: {listed(kinds)} of each finger, {len(automaton.events)} in all",
        f"X  {len(automaton.variables)} variables: {len(automaton.joints)} joints, 6 of the object's pose,"
        f" {2 * n} contact coordinates",
        "Explain a mode: drake-hand modes CODE. Draw them all: drake-hand modes --graph modes.svg",
        sep="\n",
    )


def _print_mode(answer: dict[str, Any], automaton: Automaton, mode: Mode) -> None:
    columns = ["finger", "submodel", "dof>", "n_G>", "n_B>", "n_L>", "what it constrains"]
    keys = ("finger", "submodel", "dof", "joints", "bodies", "loops", "constraint")
    title = f"{mode} of {answer['hand']}: {answer['words']}"
    print_table(title, columns, [[f[k] for k in keys] for f in answer["fingers"]])
    coupled = answer["dof"] - answer["commanded_dof"]
    less = f" ({answer['commanded_dof']} with {coupled} coupled joints)" if coupled else ""
    print(
        f"Hand and object together: {answer['dof']} dof{less}, "
        f"n_G {answer['joints']} joints - n_B {answer['bodies']} bodies = n_L {answer['loops']} loops"
    )
    for predicate in (automaton.inv(mode), automaton.contact(mode)):
        print(f"\n{predicate}")
    print(f"\ninit({mode}): inv({mode}), and hand and object at rest\n\nswitches with one finger changing")
    neighbours: dict[str, list[str]] = {}
    for s in automaton.switches(mode):
        neighbours.setdefault(s.events[0].kind, []).append(f"{s.events[0].finger} {s.after}")
    for kind, those in neighbours.items():
        print(f"  {kind:<6} {', '.join(those)}")


def _outline(ref: str) -> tuple[Automaton, list[JointCount]]:
    """Fingers and their numbers of joints, read without yourdfpy, whose import alone takes longer than this command.

    Where the files are not plain and right, the full reader says what is wrong, or knows better.
    """
    file = resolve(ref, "hands", HAND_SUFFIX)
    spec = load(file, HandSpec)
    root = read_xml(resolve(spec.urdf, "hands", ".urdf", beside=file), "robot")
    try:
        # child link: (parent link, joint, type, whether it follows another)
        above = {
            j.find("child").attrib["link"]: (  # type: ignore[union-attr]
                j.find("parent").attrib["link"],  # type: ignore[union-attr]
                j.attrib["name"],
                j.attrib["type"],
                j.find("mimic") is not None,
            )
            for j in root.findall("joint")
        }
        joints: list[str] = []
        counts = []
        for finger in spec.fingers:
            link, commanded, axes = finger.tip.link, [], 0
            while link != spec.palm:
                link, name, kind, follows = above.pop(link)
                axes += kind != "fixed"
                commanded += [name] if kind != "fixed" and not follows else []
            joints += reversed(commanded)
            counts.append(JointCount(axes=axes, couplings=axes - len(commanded)))
    except (KeyError, AttributeError):
        full = Hand.load(ref)
        return Automaton.of(full, "object"), [JointCount.of(f) for f in full.fingers]
    fingers = tuple(f.name for f in spec.fingers)
    return Automaton(fingers=fingers, joints=tuple(joints), object_name="object"), counts
