"""The one writer of measured pages: ``python -m benchmarks pages [PAGE ...]`` puts stored results into docs and README.

A page is Markdown with marks; what stands between two marks is the output of a function of the rows stored in
benchmarks/results. A test compares every page with this output, so nothing here needs the programs that measured.
``python -m benchmarks pages reproduction --from DIR`` first stores what ``twin reproduce all --out DIR`` wrote.
"""

import json
import math
import re
import shutil
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter

from benchmarks import ROOT
from benchmarks.dark_figures import PALETTE, save_both
from benchmarks.record import RESULTS, Row, read, store, stored, table

Run = tuple[float, float]
"""Seconds and error."""


def front(runs: Sequence[Run]) -> list[Run]:
    """Return the runs that no other run beats in both time and error, fastest first."""
    best: list[Run] = []
    for seconds, error in sorted(runs):
        if not best or error < best[-1][1]:
            best.append((seconds, error))
    return best


def seconds_to(runs: Sequence[Run], error: float) -> float | None:
    """Return the seconds that a program takes to an error, from its front by straight lines in log-log axes.

    A program whose fastest run is better already takes the time of that run, an upper bound. None: never so good.
    """
    best = front(runs)
    if not best or best[-1][1] > error:
        return None
    if best[0][1] <= error:
        return best[0][0]
    seconds, errors = np.log(np.array(best)).T
    return float(np.exp(np.interp(-np.log(error), -errors, seconds)))


DOCS = ROOT / "docs"


@dataclass(frozen=True, kw_only=True)
class Page:
    """A page: its file, its Markdown by mark (the whole page under ""), and what draws its pictures."""

    file: Path
    parts: Callable[[], Mapping[str, str]]
    draw: Callable[[], None] | None = None

    def text(self) -> str:
        """Return the page with the stored results in place."""
        text = self.file.read_text()
        for mark, part in self.parts().items():
            marks = rf"(<!-- {mark} -->\n).*?(<!-- end of {mark} -->)"
            text = re.sub(marks, lambda m, part=part: m[1] + part + m[2], text, flags=re.DOTALL) if mark else part  # type: ignore[misc]
        return text


def measured_on(stage: str, cores: bool = False) -> str:
    """Return the machine of a stage's last run, as a sentence."""
    told = read(stage)["machine"]
    return f"On {told['processor']}, {told['cores']} cores." if cores else f"On {told['processor']}."


def grouped(rows: list[Row], *keys: str) -> dict[tuple[Any, ...], list[Row]]:
    """Return rows by what some of their columns hold, in the order in which that comes."""
    groups: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(tuple(row[key] for key in keys), []).append(row)
    return groups


def titled(tables: Mapping[str, list[Row]]) -> str:
    """Return tables under bold titles; those without rows are left out."""
    return "\n\n".join(
        folded(title, table(rows)) if len(rows) > LONG else f"**{title}**\n\n{table(rows)}"
        for title, rows in tables.items()
        if rows
    )


LONG = 20
"""Rows of a table from which on it is shown on a click."""


def folded(title: str, content: str) -> str:
    """Return Markdown that is shown when its title is clicked, without scripts."""
    return f"<details><summary>{title}</summary>\n\n{content}\n\n</details>"


def chart(name: str, **kind: Any) -> tuple[Any, Any, Callable[[], None]]:
    """Return a figure, its panels, and what saves it as docs/NAME, for light and dark pages."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(**{"layout": "constrained", **kind})

    def save() -> None:
        save_both(figure, DOCS / name, dpi=100)
        plt.close(figure)

    return figure, panels, save


# elasticity


def ways_in_short(rows: list[Row]) -> list[Row]:
    """Return one row for every body and way: CPU seconds of first and next loads, errors, and their estimates."""
    from benchmarks.reference import reference

    short = []
    for (body, way), cases in grouped(rows, "body", "way").items():
        first, later = ([case["cpu_s"] for case in cases if case["load"] == which] for which in ("first", "next"))
        stated = [(case, reference(body).case(case["case"]).own_error) for case in cases if "estimate" in case]
        told = [case["estimate"] / case["error"] for case, _ in stated]
        fair = [case["estimate"] / (case["error"] + own) for case, own in stated]
        short.append(
            {
                "body": body,
                "way": way,
                "unknowns": cases[0]["unknowns"],
                "first load, CPU s": median(first) if first else "",
                "next load, CPU s": median(later) if later else "",
                "cases": len(cases),
                "worst error, %": 100 * max(case["error"] for case in cases),
                "at markers, %": 100 * max(case["marker_error"] for case in cases),
                "estimate over error": f"{min(told):.2g} to {max(told):.2g}" if told else "",
                "over error plus reference's own": f"{min(fair):.2g} to {max(fair):.2g}" if fair else "",
            }
        )
    return short


def _elasticity() -> dict[str, str]:
    ways = {"Every way of the program, over all reference cases": ways_in_short(stored("elasticity"))}
    return {"results": f"\n{titled(ways)}\n\n{measured_on('elasticity')}\n"}


# contact: stage contact, and presses


NO_ORDER = ("total force", "collinear residual")


def series(rows: list[Row]) -> list[list[Row]]:
    """Return the rows of closed forms by case, Poisson's ratio and quantity."""
    return list(grouped(rows, "case", "nu", "quantity").values())


def order(rows: list[Row]) -> float:
    """Return the slope of log error over log patch size of one quantity's rows, by least squares."""
    size = np.log([1.0 / row["across"] for row in rows])
    return float(np.polyfit(size, np.log([max(abs(row["error"]), 1e-12) for row in rows]), 1)[0])


def extrapolated(rows: list[Row]) -> float:
    """Return the error of the value that the last three grids lead to (Aitken), sizes in equal ratios or nearly so."""
    one, two, three = (row["error"] for row in rows[-3:])
    bend = (three - two) - (two - one)
    return float(three - (three - two) ** 2 / bend) if bend else float(three)


def _closed_table(rows: list[Row]) -> list[Row]:
    """Return one row a quantity: the error on every grid, the order, and what three grids lead to."""
    shown, sizes = [], sorted({row["across"] for row in rows})
    for one in series(rows):
        last, errors = one[-1], {row["across"]: 100 * row["error"] for row in one}
        row = {"case": last["case"], "nu": last["nu"], "quantity": last["quantity"]}
        row |= {f"{across} across, %": errors.get(across, "") for across in sizes}
        if last["quantity"] not in NO_ORDER:
            row["order"] = order(one)
        if last["case"].startswith(("flat", "stuck")):
            row["extrapolated, %"] = 100 * extrapolated(one)
        shown.append(row | {"finest, CPU s": last["cpu_s"]})
    return shown


def _contact() -> dict[str, str]:
    rows = stored("contact")
    parts = ["**On a half-space** (error over the closed form's value)", table(_closed_table(rows))]
    for kept in sorted(RESULTS.glob("presses_*.json")):
        found, body = read(kept.stem), kept.stem.removeprefix("presses_")
        refused = ", ".join(f"{words} {count}" for words, count in sorted(found["refused"].items())) or "none"
        groups = [{"probe and friction": name, **group} for name, group in sorted(found["groups"].items())]
        parts += [
            f"**{found['done']} random presses on the {body}: {len(found['failed'])} failed** (refused: {refused})",
            table(groups),
        ]
    return {"results": "\n" + "\n\n".join([*parts, measured_on("contact")]) + "\n\n"}


def _draw_contact() -> None:
    """Draw errors against patches across, and against CPU seconds.

    A panel a case; what is compared has its colour, and Poisson's ratios other than 0.5 are dashed.
    """
    from matplotlib.ticker import NullFormatter, ScalarFormatter

    drawn = [one for one in series(stored("contact")) if one[-1]["quantity"] not in NO_ORDER]
    groups: dict[str, list[list[Row]]] = {}
    for one in drawn:
        case = one[-1]["case"]
        groups.setdefault("punches" if "punch" in case else case, []).append(one)
    _, panels, save = chart(
        "contact.png", nrows=2, ncols=len(groups), figsize=(3.2 * len(groups), 7), sharey=True, squeeze=False
    )
    for (name, mine), (upper, lower) in zip(groups.items(), panels.T, strict=True):
        labels = [f"{one[-1]['case']}: {one[-1]['quantity']}" for one in mine]
        colours = dict(zip(dict.fromkeys(labels), PALETTE, strict=False))
        for one, label in zip(mine, labels, strict=True):
            line = "-" if one[-1]["nu"] == 0.5 else "--"
            style = {"color": colours[label], "marker": "o", "ls": line, "ms": 4, "lw": 1.2}
            errors = [max(abs(row["error"]), 1e-6) for row in one]
            upper.loglog([row["across"] for row in one], errors, **style)
            words = label if name == "punches" else one[-1]["quantity"]
            lower.loglog([row["cpu_s"] for row in one], errors, label=f"{words}, nu {one[-1]['nu']}", **style)
        upper.set(title=name, xlabel="patches across the contact")
        upper.set_xticks(sorted({row["across"] for one in mine for row in one}))
        upper.xaxis.set_major_formatter(ScalarFormatter())
        upper.xaxis.set_minor_formatter(NullFormatter())
        lower.set(xlabel="CPU seconds of the whole path")
        lower.legend(loc="upper center", bbox_to_anchor=(0.5, -0.18), fontsize=7)
    for first in panels[:, 0]:
        first.set_ylabel("error over the closed form's value")
    save()


# pictures and tracking

GOAL_PX = 0.003
"""Centroid error, rms, at which methods are compared."""


def pictures_to_the_goal(rows: list[Row]) -> list[Row]:
    """Return one row for every scene and method with shadows: CPU time to the goal, and over the splat's."""
    shaded = grouped([row for row in rows if row.get("shadows") is True], "scene", "method")
    needed = {key: seconds_to(picture_runs(mine), GOAL_PX) for key, mine in shaded.items()}
    return [
        {"scene": scene, "method": method, "CPU ms": cost, "over the splat": cost / needed[scene, "twin, splat"]}
        for (scene, method), cost in needed.items()
    ]


def picture_runs(rows: list[Row]) -> list[Run]:
    """Return CPU ms and centroid error of pictures."""
    return sorted((row["cpu_ms"], row["centroid_rms_px"]) for row in rows)


def _picture() -> dict[str, str]:
    rows = stored("picture")
    goal = {f"CPU time to a centroid error of {GOAL_PX} px rms, with shadows": pictures_to_the_goal(rows)}
    tables = {
        "Every method and grid": [row for row in rows if "centroid_rms_px" in row],
        "The CCD": [r for r in rows if "centroid_rms_px" not in r],
    }
    plot = "![Centroid error against CPU time](picture.png)"
    return {"results": f"\n{titled(goal)}\n\n{plot}\n\n{titled(tables)}\n"}


def _draw_picture() -> None:
    """Draw error against CPU time, one line for every method."""
    rows = [row for row in stored("picture") if row.get("shadows") is True]
    scenes = list(dict.fromkeys(row["scene"] for row in rows))
    _, panels, save = chart("picture.png", nrows=1, ncols=len(scenes), figsize=(10, 4), sharey=True)
    for panel, scene in zip(np.atleast_1d(panels), scenes, strict=True):
        methods = grouped([row for row in rows if row["scene"] == scene], "method")
        for ((method,), mine), colour in zip(methods.items(), PALETTE, strict=False):
            panel.loglog(*zip(*picture_runs(mine), strict=True), "o-", color=colour, label=method)
        panel.axhline(GOAL_PX, color="grey", lw=0.8)
        panel.set(title=scene, xlabel="CPU time of a picture, ms")
        shown = [t for t in (5, 10, 20, 50, 100, 200, 500) if panel.get_xlim()[0] <= t <= panel.get_xlim()[1]]
        panel.set_xticks(shown, [str(t) for t in shown])
        panel.set_xticks([], minor=True)
        panel.legend()
    np.atleast_1d(panels)[0].set_ylabel("centroid error, px rms")
    save()


def _tracking() -> dict[str, str]:
    rows = stored("tracking")
    chains = [row for row in rows if row["way"].startswith("chain")]
    errors = [row for row in rows if row not in chains]
    return {
        "results": f"{table(errors)}\n\n{measured_on('tracking')}\n",
        "chain": f"{table(chains)}\n",
        "fingers": f"{table(stored('fingers'))}\n",
    }


# the inverse problem: stages inverse and calibrations


def _inverse() -> dict[str, str]:
    rows = stored("inverse")
    wide = [row for row in rows if row["what"].startswith("point push")]
    speed = [row for row in rows if "CPU ms" in row]
    ways = [row for row in rows if "field error" in row and row not in wide and row not in speed]
    others = [f"* {row['what']}" for row in rows if row not in [*ways, *speed, *wide]]
    return {
        "results": f"{table(ways)}\n\n{measured_on('inverse')}\n",
        "width": f"{table(wide)}\n",
        "remarks": "\n".join(others) + "\n",
        "time": f"{table(speed)}\n",
    }


def _calibrations() -> dict[str, str]:
    rows = [
        {
            "truth": row["truth"],
            "calibration": row["calibration"],
            "presses": row["presses"],
            "sensors": row["sensors"],
            "transfer, between %": row["transfer %"],
            "transfer, edge %": row["transfer %, edge"],
            "transfer, worst %": max(row["transfer %, worst"], row["transfer %, edge, worst"]),
            "total of a distributed load %": row.get("total %", ""),
        }
        for row in stored("calibrations")
    ]
    return {"results": f"{table(rows)}\n"}


# linearity: a study that was stored once, and stage finite_strain


def _validity() -> dict[str, str]:
    study = folded("Neo-Hookean rubber against linear theory, same elements, same force", table(stored("validity")))
    last = f"Contact counted on the study's own meshes. {measured_on('validity')}"
    found = {"results": f"\n{study}\n\n{last}\n"}
    for mark, whether in (("slabs", True), ("bodies", False)):
        rows = [row for row in stored("finite_strain") if row["body, mm"].startswith("block") == whether]
        over = [row["stated, %"] / row["left, %"] for row in rows]
        silent = sum(row["stated, %"] + row["NGSolve off, %"] < row["left, %"] for row in rows)
        found[mark] = (
            f"\n{folded(f'{len(rows)} presses', table(rows))}\n\nStated over left: {min(over):.2g} to {max(over):.2g}, "
            f"median {median(over):.2g}; {silent} of {len(rows)} leave more than is stated. "
            f"{measured_on('finite_strain')}\n"
        )
    return found


# error budget: stage budget

STAGES = ("contact", "elasticity", "optics", "CCD noise", "tracking", "inverse model", "regularisation")


def by_scene(rows: list[Row]) -> dict[str, dict[str, Row]]:
    """Return the rows of each stage of each scene, stages in the chain's order."""
    scenes = grouped([row for row in rows if "stage" in row], "scene")
    return {
        scene: {row["stage"]: row for row in sorted(mine, key=lambda row: STAGES.index(row["stage"]))}
        for (scene,), mine in scenes.items()
    }


def part_of_error(row: Row) -> float:
    """Return a stage's part of the error: its bias and its noise together."""
    return float(np.hypot(row["share"], row["sd"]))


def _budget() -> dict[str, str]:
    rows = stored("budget")
    scenes = by_scene(rows)
    limits, shares = [], []
    for scene, mine in scenes.items():
        worst, slowest = max(mine, key=lambda s: part_of_error(mine[s])), max(mine, key=lambda s: mine[s]["cpu_s"])
        limits.append(
            {
                "scene": scene,
                "force error, %": 100 * next(iter(mine.values()))["total_force_error"],
                "most of it by": worst,
                "without that, %": 100 * mine[worst]["error_without"],
                "CPU s": sum(row["cpu_s"] for row in mine.values()),
                "most of them in": f"{slowest} ({mine[slowest]['cpu_s']:.2f} s)",
            }
        )
        shares.append({"scene": scene, **{stage: 100 * part_of_error(row) for stage, row in mine.items()}})
    tables = {"budget": [limits, shares], "auto": [[row for row in rows if "stage" not in row]]}
    return {mark: "\n" + "".join(f"{table(each)}\n\n" for each in parts) for mark, parts in tables.items()}


def _draw_budget() -> None:
    """Draw every scene's error and time by stage."""
    scenes = by_scene(stored("budget"))
    size = (11, 0.6 + 0.62 * len(scenes))
    figure, (left, right), save = chart("budget.png", nrows=1, ncols=2, figsize=size, sharey=True, layout=None)
    places = np.arange(len(scenes))[::-1]
    for axes, value, name in (
        (left, lambda row: 100 * part_of_error(row), "part of the total force's error, % of the force"),
        (right, lambda row: row["cpu_s"], "CPU seconds of a first press"),
    ):
        edge = np.zeros(len(scenes))
        for stage, colour in zip(STAGES, PALETTE, strict=False):
            width = np.array([value(mine[stage]) if stage in mine else 0.0 for mine in scenes.values()])
            axes.barh(places, width, left=edge, color=colour, label=stage, height=0.7)
            edge += width
        axes.set_xlabel(name)
        axes.spines[["top", "right"]].set_visible(False)
    errors = [100 * next(iter(mine.values()))["total_force_error"] for mine in scenes.values()]
    left.plot(errors, places, "k|", markersize=16, label="the whole")
    left.set_yticks(places, list(scenes))
    left.legend(fontsize=7, loc="best")
    figure.tight_layout()
    save()


# what is shown as it is stored


def _sweeps() -> dict[str, str]:
    rows = stored("sweep")
    rates = [row for row in rows if "designs_per_s" in row]
    others = [row for row in rows if "designs_per_s" not in row]
    return {"results": f"\n{table(rates)}\n\n{table(others)}\n\n{measured_on('sweep')}\n"}


def _dataset() -> dict[str, str]:
    cores = read("dataset")["machine"]["cores"]
    rows = []
    for row in stored("dataset"):
        before = list(row)[: list(row).index("total") + 1]
        rows.append({key: row[key] for key in before} | {"per_s": 1000.0 * cores / row["total"]} | row)
    return {"results": f"{measured_on('dataset', cores=True)}\n\n{table(rows)}\n"}


def _inclusions() -> dict[str, str]:
    """Return a titled table for every kind of row, and the machine."""
    kinds = {
        what: [{key: value for key, value in row.items() if key != "what"} for row in rows]
        for (what,), rows in grouped(stored("inclusions"), "what").items()
    }
    return {"results": f"\n{titled(kinds)}\n\n{measured_on('inclusions', cores=True)}\n"}


NEAR = 0.7
"""Error over the stated one from which on a random body is listed."""


def _stability() -> dict[str, str]:
    bodies: list[Row] = []
    compared = [row for row in stored("random_bodies") if "off" in row]
    for row in compared:
        off, stated = row["off"], row["stated"]
        what = max(("force", "indentation"), key=stated.__getitem__)
        shown = {"case": f"{row['number']}: {row['what']}", "of the": what, "stated": stated[what], "off": off[what]}
        if max(off[what] / stated[what], off["traction"] / stated["traction"]) > NEAR:
            bodies.append({**shown, "tractions stated": stated["traction"], "tractions off": off["traction"]})
    title = f"The {len(bodies)} of {len(compared)} of the second series that are off by over {NEAR:g} times"
    parts = []
    for kind, words in (("valid", "Random valid scenes"), ("invalid", "Random spoilt recipes")):
        mine = read("random_scenes")[kind]
        rows = [{"what became of it": what, "scenes": n} for what, n in mine["outcomes"].items()]
        largest = [{"what": what, "largest": size} for what, size in mine["worst"].items()]
        counts = f"{mine['drawn']} drawn, {mine['outcomes'].get('failed', 0)} failed"
        heading = f"{words}: {counts}, {mine['cpu_s']:.0f} CPU s, the slowest {mine['slowest_s']:.3g} s"
        parts.append(folded(heading, "\n\n".join(table(each) for each in (rows, largest) if each)))
    sums = {name: Counter[str]() for name in ("fuzz", "kills")}
    for name, keys in (("fuzz", ("attempts", "failed")), ("kills", ("killed", "lost or torn"))):
        for row in stored(name):
            sums[name].update({key: row.get(key, 0) for key in keys})
    fuzz, kills, lasted = sums["fuzz"], sums["kills"], read("endurance")
    tried = f"{fuzz['attempts']} attempts on {len(stored('fuzz'))} readers, {fuzz['failed']} failed"
    headings = {
        "fuzz": f"Damaged and hostile files: {tried}",
        "kills": f"Killed at {kills['killed']} random moments: {kills['lost or torn']} files lost or torn",
        "endurance": f"{lasted['minutes']:.0f} minutes of mixed work in one process, {lasted['rounds']} rounds",
    }
    parts += [folded(heading, table(stored(name))) for name, heading in headings.items()]
    return {
        "bodies": f"\n{folded(f'{title} what is stated', table(bodies))}\n\n",
        "results": "\n".join(["", *(f"{part}\n" for part in parts)]),
    }


# wrong lines


def _trust() -> dict[str, str]:
    """Return how many wrong lines of each folder the quick tests caught, and every survivor."""
    rows = stored("mutation")
    counts = [
        {"folder": f"twin/{wing}", "planted": len(mine), "caught": sum(bool(row["caught by"]) for row in mine)}
        for (wing,), mine in sorted(grouped(rows, "wing").items())
    ]
    caught = sum(row["caught"] for row in counts)
    survivors = [
        {
            "survivor": f"{row['file'].removeprefix('twin/')}:{row['line']}",
            "planted": f"`{row['after']}`".replace("|", "\\|"),
            "instead of": f"`{row['before']}`".replace("|", "\\|"),
            "tests met": row["met"],
            "judgement": row["judgement"],
        }
        for row in rows
        if not row["caught by"]
    ]
    share = f"{100 * caught / len(rows):.0f} %"
    drawn = read("mutation")["drawn"]
    added = sum(bool(row["caught by"]) and row["judgement"] == "test added" for row in rows)
    heading = (
        f"**{caught} of {len(rows)} wrong lines caught, {share}, {added} of them by tests that were added for them.** "
        f"{drawn} are drawn; these were planted so far."
    )
    return {"wrong lines": f"\n{heading}\n\n{table(counts)}\n\n{table(survivors)}\n"}


# the papers: twin reproduce

PICTURES = {"beyond_limits.svg": "reproduction_limits.svg", "beyond_half-space.svg": "reproduction_half_space.svg"}


def store_reproduction(folder: Path) -> None:
    """Keep a reproduction's numbers, and seconds by entry, in benchmarks/results; its pictures in docs."""
    from twin.study.reproduce.reproduction_run import ENTRIES

    entries = {e["name"]: e for e in (json.loads(f.read_text()) for f in (folder / "entries").glob("*.json"))}
    if missing := sorted(set(ENTRIES) - set(entries)):
        raise SystemExit(f"{folder} lacks {', '.join(missing)}: run twin reproduce all --out {folder}")
    rows: list[Row] = [{"record": record} for record in json.loads((folder / "results.json").read_text())]
    rows += [{"entry": n, "wall": entries[n]["seconds"], "CPU": entries[n]["cpu_seconds"]} for n in ENTRIES]
    store("reproduction", rows)
    for name, copy in PICTURES.items():
        shutil.copyfile(folder / name, DOCS / copy)


def _reproduction() -> dict[str, str]:
    from twin.study.reproduce.design_limits import in_short
    from twin.study.reproduce.reproduction_run import ENTRIES

    rows = stored("reproduction")
    records = [row["record"] for row in rows if "record" in row]
    said = Counter(_short(r["verdict"]) for r in records if r["paper"] is not None and not r["timed"] and not r["ours"])
    counts = "; ".join(f"{count} {what}" for what, count in said.most_common())
    parts = {"counts": f"Of {sum(said.values())} numbers that the papers print: {counts}.\n"}
    sections = (f"**{title}.** {' '.join(lines)}" for title, lines in in_short(records).items())
    parts["short"] = "\n\n".join(sections) + "\n"
    half_space = [
        {"load and layer": r["quantity"].split(":")[0], "off by, over the largest motion": r["twin"]}
        for r in records
        if r["name"] == "beyond/half-space"
    ]
    same_hardware = [_beside(r) for r in records if r["name"].startswith("beyond/same-hardware")]
    assert all(ENTRIES[r["entry"]].cpu_seconds == math.ceil(r["CPU"]) for r in rows if "entry" in r), "entries.toml"
    took = sorted(((entry.cpu_seconds, name) for name, entry in ENTRIES.items()), reverse=True)
    longest = ", ".join(f"{name} ({seconds})" for seconds, name in took[:4])
    parts["seconds"] = f"All took {sum(s for s, _ in took)} s of one core, beside other work. Longest: {longest}.\n"
    tables = {"same hardware": same_hardware, "half-space": half_space}
    return parts | {mark: f"{table(shown)}\n" for mark, shown in tables.items()}


def _numbers() -> dict[str, str]:
    from twin.study.reproduce.bench import FITTED
    from twin.study.reproduce.record import Record

    records = [row["record"] for row in stored("reproduction") if "record" in row]
    parts = {"unprinted": f"{table([_unprinted(row) for row in Record.settled(records)[1]])}\n"}
    for paper, sensor in (("kamiyama", "The flat sensor (Kamiyama)"), ("sato", "The finger (Sato)")):
        mine = [_printed(r) for r in records if r["name"].startswith(paper) and r["paper"] is not None]
        title = f"{sensor}: {len(mine)} numbers. Fitted: {'; '.join(FITTED[paper])}"
        parts[paper] = f"{folded(title, table(mine))}\n"
    return parts


def _short(verdict: str) -> str:
    if verdict.startswith("explained by") and " is plausible)" in verdict:
        return "explained by what isn't printed"
    kinds = {
        "agrees": "agree",
        "explained by: reading": "explained by another reading",
        "explained by": "explained by a cause that was switched off",
        "partly explained": "explained in part",
        "ruled out": "not explained, with a bound",
    }
    return next((kind for start, kind in kinds.items() if verdict.startswith(start)), "not explained")


def _unprinted(row: Mapping[str, Any]) -> Row:
    def words(parts: Sequence[Sequence[float]]) -> str:
        return " or ".join(f"{low:.3g} to {high:.3g}" for low, high in parts) or "no value"

    return {
        "paper": row["paper"],
        "what isn't printed": f"{row['name']} ({row['unit']})".replace(" ()", ""),
        "plausible": f"{words([row['plausible']])}: {row['why']}",
        "gives all its numbers at once": f"{words(row['at_once'])} ({len(row['allowed'])} numbers)",
    }


def _printed(record: Row) -> Row:
    spread = f" ± {record['spread']:.2g}" if record["spread"] is not None else ""
    return {
        "entry": record["name"].split("/")[1],
        "number": record["quantity"],
        "unit": record["unit"],
        "paper": f"{record['paper']:g}",
        "twin": "not defined" if record["twin"] is None else f"{record['twin']:.3g}{spread}",
        "n": record["n"],
        "agreement": re.sub(r" \([^()]* is plausible\)", "", record["verdict"]),
    }


def _beside(record: Row) -> Row:
    from twin.study.reproduce.design_limits import CAMERA, DEFAULT, PAPERS

    def value(number: float | None) -> str:
        return "" if number is None else f"{number:.3g}" if abs(number) < 1e3 else f"{number:.0f}"

    others = {cause["cause"]: cause["value"] for cause in record["explained_by"]}
    spread = f" ± {record['spread']:.2g}" if record["spread"] else ""
    return {
        "number": record["quantity"],
        "unit": record["unit"],
        "paper prints": value(record["paper"]),
        "with the paper's software": value(others.get(PAPERS)),
        "with the default inverse": value(others.get(DEFAULT)),
        "with this project's": f"{value(record['twin'])}{spread}",
        "and an industrial camera": value(others.get(CAMERA)),
        "n": record["n"],
    }


# the README and docs/speed.md: stages elasticity, picture and chain


def _speed() -> dict[str, str]:
    """Return the long tables, without what no one would choose: plain elements but for the standard mesh, pictures
    without shadows."""
    ways = ways_in_short(stored("elasticity"))
    columns = ("scene", "method", "k", "cpu_ms", "centroid_rms_px", "centroid_max_px")
    pictures = [row for row in stored("picture") if row.get("shadows") is True and row["k"] in (2, 3, 4, 8)]
    tables = {
        "elasticity": [row for row in ways if not row["way"].startswith("direct") or "standard" in row["way"]],
        "picture": [{c: row.get(c, "") for c in columns} for row in pictures],
        "chain": stored("chain"),
    }
    return {stage: f"{measured_on(stage, cores=True)}\n\n{table(rows)}\n" for stage, rows in tables.items()}


def _readme() -> dict[str, str]:
    """Return the README's table: what a user waits for, its time and its error."""

    def only(rows: list[Row], **wanted: Any) -> Row:
        (row,) = (row for row in rows if all(row.get(key) == value for key, value in wanted.items()))
        return row

    ways, lines = ways_in_short(stored("elasticity")), []
    for body, way in (("block", "table, nominal"), ("finger", "subtracted, nominal")):
        row = only(ways, body=body, way=way)
        milliseconds = f"{1e3 * row['next load, CPU s']:.3g} ms"
        error = f"{row['worst error, %']:.2g} % of the largest displacement"
        lines.append({"job": f"displacement under one more load, {body}", "time": milliseconds, "error": error})
    for method, name in (("twin, splat", "closed form"), ("twin, llvm_ad_rgb", "Mitsuba")):
        row = only(stored("picture"), scene="kamiyama_pillar", method=method, k=2, shadows=True)
        error = f"{row['centroid_rms_px']:.1g} px (rms of centroids)"
        lines.append({"job": f"picture of 640x480, {name}", "time": f"{row['cpu_ms']:.2g} ms", "error": error})
    for row in stored("chain"):
        if row["scene"] in ("kamiyama_pillar", "sato_press"):
            seconds = sum(value for key, value in row.items() if key.endswith("_s"))
            error = f"force {100 * row['total_force_error']:.2g} %, its centre {row['centre_error_mm']:.2g} mm"
            lines.append({"job": f"the whole chain, `{row['scene']}`", "time": f"{seconds:.2g} s", "error": error})
    return {"results": f"\n{table(lines)}\n"}


def _draw_chain() -> None:
    """Draw the README's picture from a run: CCD picture, marker motion, force field; both sensors."""
    from twin.study.recipe import load_scene
    from twin.study.run import run

    _, panels, save = chart("chain.png", nrows=2, ncols=3, figsize=(12, 6.2))
    said = {"kamiyama_shear": "flat sensor, pressed and sheared", "sato_press": "finger, pressed by a 3 mm sphere"}
    for row, name in zip(panels, said, strict=True):
        result = run(load_scene(name))
        truth, estimate = result.truth, result.estimate
        row[0].imshow(np.minimum(result.pressed.astype(int) * 3 // 2, 255))
        row[0].set(title="what the CCD sees (brightened)", ylabel=said[name])
        rest, shift = estimate.marker_rest_px, estimate.marker_shift_px
        for layer, colour in (("red", "#c8381e"), ("blue", "#1f5fbf")):
            mine = truth.marker_layer == layer
            row[1].quiver(*rest[mine].T, *shift[mine].T, color=colour, angles="xy", width=0.003)
        moved = f"how the markers moved (up to {np.nanmax(np.hypot(*shift.T)):.2g} px)"
        row[1].set(xlim=(0, 640), ylim=(480, 0), aspect="equal", title=moved)
        x, y = estimate.site_mm[:, :2].T
        fx, fy, fz = estimate.force_n.T
        row[2].scatter(x, y, c=fz, cmap="PuOr_r", vmin=-abs(fz).max(), vmax=abs(fz).max(), marker="s", s=60)
        pitch, largest = load_scene(name).reconstruction.sites.pitch_mm, np.hypot(fx, fy).max()
        scale = largest / (1.5 * pitch)
        row[2].quiver(x, y, fx, fy, angles="xy", scale_units="xy", scale=scale, width=0.004)
        found = f"forces: push to {fz.max():.2g}, side to {largest:.2g} N"
        row[2].set(aspect="equal", title=found)
        for panel in row:
            panel.set_xticks([])
            panel.set_yticks([])
    save()


PAGES = {
    "readme": Page(file=ROOT / "README.md", parts=_readme, draw=_draw_chain),
    "speed": Page(file=DOCS / "speed.md", parts=_speed),
    "elasticity": Page(file=DOCS / "elasticity.md", parts=_elasticity),
    "contact": Page(file=DOCS / "contact.md", parts=_contact, draw=_draw_contact),
    "picture": Page(file=DOCS / "picture.md", parts=_picture, draw=_draw_picture),
    "effects": Page(file=DOCS / "picture_effects.md", parts=lambda: {"effects": f"{table(stored('effects'))}\n"}),
    "tracking": Page(file=DOCS / "tracking.md", parts=_tracking),
    "inverse": Page(file=DOCS / "inverse.md", parts=_inverse),
    "calibrations": Page(file=DOCS / "calibrations.md", parts=_calibrations),
    "validity": Page(file=DOCS / "validity.md", parts=_validity),
    "budget": Page(file=DOCS / "budget.md", parts=_budget, draw=_draw_budget),
    "inclusions": Page(file=DOCS / "inclusions.md", parts=_inclusions),
    "dataset": Page(file=DOCS / "dataset.md", parts=_dataset),
    "sweeps": Page(file=DOCS / "sweeps.md", parts=_sweeps),
    "stability": Page(file=DOCS / "stability.md", parts=_stability),
    "trust": Page(file=DOCS / "trust.md", parts=_trust),
    "reproduction": Page(file=DOCS / "reproduction.md", parts=_reproduction),
    "reproduction_numbers": Page(file=DOCS / "reproduction_numbers.md", parts=_numbers),
}


def write(name: str) -> None:
    """Put the stored results into a page, and draw its pictures."""
    page = PAGES[name]
    if page.draw is not None:
        page.draw()
    page.file.write_text(page.text())


def measure(*pages: str, reproduced: Annotated[Path | None, Parameter(name="--from")] = None) -> None:
    """Write the wanted pages, all by default.

    Parameters
    ----------
    reproduced
        What ``twin reproduce`` wrote, to be stored first.
    """
    if unknown := sorted(set(pages) - set(PAGES)):
        raise SystemExit(f"unknown {', '.join(unknown)}: choose from {', '.join(PAGES)}")
    if reproduced is not None:
        if not (reproduced / "results.json").is_file():
            raise SystemExit(f"{reproduced}: holds no results.json; give the folder that twin reproduce wrote")
        store_reproduction(reproduced)
    for name in pages or PAGES:
        write(name)
