"""The results of a sweep: a summary by task and varied values, and figures."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from statistics import median

from drake_hand.sweep.spec import Case
from drake_hand.sweep.work import CaseRow


def groups(cases: list[Case], rows: dict[str, CaseRow]) -> dict[str, list[CaseRow]]:
    """Rows by task and varied values; seeds together."""
    out: dict[str, list[CaseRow]] = {}
    for case in cases:
        label = ", ".join([case.name, *(f"{k.rpartition('.')[2]} {v}" for k, v in case.varied.items())])
        if case.id in rows:
            out.setdefault(label, []).append(rows[case.id])
    return out


def summary(grouped: dict[str, list[CaseRow]]) -> list[tuple[object, ...]]:
    """Per group: label, cases, certified, why not, median s to plan, median regrasps, replays that succeeded."""
    out: list[tuple[object, ...]] = []
    for label, rows in grouped.items():
        good = [r for r in rows if r.status == "certified"]
        others = Counter(r.status for r in rows if r.status != "certified")
        runs = sum(r.replays for r in good)
        out.append(
            (
                label,
                len(rows),
                len(good),
                ", ".join(f"{n} {status}" for status, n in others.items()),
                median(r.plan_s or 0.0 for r in good) if good else "",
                int(median(r.regrasps or 0 for r in good)) if good else "",
                f"{sum(r.successes for r in good)} of {runs}" if runs else "",
            )
        )
    return out


def plot_groups(grouped: dict[str, list[CaseRow]], folder: Path) -> list[Path]:
    """Draws the results of each group, and how long planning took, as PNG files."""
    from matplotlib.figure import Figure

    from drake_hand.view.style import save

    labels, heights = list(grouped), 1.2 + 0.35 * len(grouped)
    statuses = sorted({r.status for rows in grouped.values() for r in rows}, key=lambda s: (s != "certified", s))
    figure = Figure(figsize=(9, heights), layout="constrained")
    axes = figure.subplots()
    left = [0] * len(labels)
    for status in statuses:
        counts = [sum(r.status == status for r in rows) for rows in grouped.values()]
        axes.barh(labels, counts, left=left, label=status)
        left = [a + b for a, b in zip(left, counts, strict=True)]
    axes.invert_yaxis()
    axes.set_xlabel("cases")
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=len(statuses), frameon=False)
    files = save(figure, folder, "status", ["png"])
    times = {k: [r.plan_s for r in rows if r.plan_s is not None] for k, rows in grouped.items()}
    times = {k: v for k, v in times.items() if v}
    if times:
        figure = Figure(figsize=(9, heights), layout="constrained")
        axes = figure.subplots()
        axes.boxplot(list(times.values()), orientation="horizontal", tick_labels=list(times), showfliers=True)
        axes.invert_yaxis()
        axes.set_xscale("log")
        axes.set_xlabel("s to plan")
        files += save(figure, folder, "plan_s", ["png"])
    return files
