"""The document's tables, each made from the results and its marker's arguments."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from postfx.tools.bench.report import choices, is_better
from training.measure.quality_report.document import (
    FORMS,
    NAMES,
    Facts,
    Missing,
    ReportError,
    Results,
    bold,
    is_network,
    method_title,
    number,
    place,
    table,
)
from training.measure.validation.compare import FRAMEWISE

# Sequences that `postfx bench` measured -----------------------------------------------------------

GAINS = {"psnr": ("+.2f", ""), "ssim": ("+.4f", ""), "flip": (".2f", "x"), "flicker": (".2f", "x")}
"""Figures of comparisons: differences (PSNR in dB, SSIM) or quotients."""
PARTS = {"oidn": 0, "plain": 1, "ours": 2}


def conditions(results: Results, *names: str) -> str:
    """The conditions under which the sequences were measured."""
    rows = []
    for name, facts in _benches(results, names).items():
        sizes = " to ".join("x".join(map(str, facts[key]))
                            for key in ("render_size", "output_size"))
        versions = ", ".join(f"{key} {value}" for key, value in facts["versions"].items())
        where = f"{facts['device']}, {facts['threads']} threads, {facts['machine']['processor']}"
        rows.append([place(name), sizes, str(len(facts["sequence"]["frames"])),
                     "yes" if facts["guides"] else "no", where, str(facts["runs"]), versions])
    return table(["sequence", "size", "frames", "guides", "measured on", "runs", "with"], rows)


def methods(results: Results, name: str) -> str:
    """All figures of all methods, with the best of each in bold."""
    rows = sorted(choices(results.bench(name)["methods"]), key=lambda row: PARTS[row["family"]])
    best = {figure: _best(rows, figure) for figure in FORMS}
    cells = [[method_title(row["name"]), *(_figure(row, figure, best[figure]) for figure in FORMS)]
             for row in rows]
    return table(["method", *NAMES.values()], cells)


def gains(results: Results, *names: str) -> str:
    """Our networks against the best of the other methods, figure by figure, with the mean over the
    sequences."""
    benches = _benches(results, names)
    networks = dict.fromkeys(row["name"] for facts in benches.values()
                             for row in facts["methods"] if is_network(row))
    rows = []
    for figure, (form, unit) in GAINS.items():
        best = []
        for facts in benches.values():
            row = _best([row for row in facts["methods"] if row["family"] != "ours"], figure)
            if row is None:
                raise Missing("a sequence was measured without other methods than ours")
            best.append(row)
        told = [f"{_score(row, figure):{FORMS[figure]}} ({method_title(row['name'])})"
                for row in best]
        rows.append([f"{NAMES[figure]}{', dB' if figure == 'psnr' else ''}", "best of the others",
                     *told, ""])
        for network in networks:
            values = [_gain(facts, network, figure) for facts in benches.values()]
            rows.append(["", method_title(network),
                         *(number(value, form, unit) for value in values),
                         _mean(values, form, unit)])
    return table(["figure", "method", *map(place, names), "mean"], rows)


def frames(results: Results, *names: str) -> str:
    """The number of each network's frames whose PSNR is below OIDN high's, and the frame with the
    smallest lead."""

    def cell(facts: Facts, network: str) -> str:
        own, other = _row(facts, network), _row(facts, "oidn-high")
        if not own or not other:
            return "-"
        pairs = [(mine["psnr"] - its["psnr"], mine["frame"])
                 for mine, its in zip(own["frames"], other["frames"], strict=True)]
        least, frame = min(pairs)
        return (f"{sum(gap < 0 for gap, _ in pairs)} of {len(pairs)}, least "
                f"{number(least, '+.2f')} dB (frame {frame})")

    return _by_network(_benches(results, names), cell)


def history(results: Results, *names: str) -> str:
    """Each network with history, against itself without history."""

    def cell(facts: Facts, network: str) -> str:
        own, alone = _row(facts, network), _row(facts, f"{network}-alone")
        if not own or not alone:
            return "-"
        gap = _difference(_score(own, "psnr"), _score(alone, "psnr"))
        # the first has no history either way
        pairs = list(zip(own["frames"], alone["frames"], strict=True))[1:]
        least = min((one["psnr"] - other["psnr"] for one, other in pairs), default=None)
        ratio = _ratio(_score(own, "flicker"), _score(alone, "flicker"))
        return (f"{number(gap, '+.2f')} dB, least frame {number(least, '+.2f')} dB, flicker "
                f"{number(ratio, '.2f')}x")

    return _by_network(_benches(results, names), cell)


def front(results: Results, figure: str, *names: str) -> str:
    """Run time and a figure of all methods, bold where no other method is better in both."""
    if f"{figure}_late" not in ("psnr_late", "flicker_late"):
        raise ReportError(f"front {figure}: there are fronts of psnr and flicker")
    benches = _benches(results, names)
    time = {name: "wall_ms" if facts["device"] == "cpu" else "gpu_ms"
            for name, facts in benches.items()}
    known = {row["name"]: row for facts in benches.values() for row in choices(facts["methods"])}
    fronts = {name: facts["fronts"][f"{figure}_late"] for name, facts in benches.items()}
    rows = []
    for method in sorted(known, key=lambda name: PARTS[known[name]["family"]]):
        found = {name: _row(facts, method) for name, facts in benches.items()}
        if known[method]["alone"] and not any(method in found for found in fronts.values()):
            continue
        rows.append([method_title(method), *("-" if row is None else bold(
            f"{number(row['time'][time[name]], '.0f')} ms, "
            f"{number(_score(row, figure), FORMS[figure])}",
            method in fronts[name]) for name, row in found.items())])
    return table(["method", *(f"{place(name)}: ms a frame, {NAMES[figure]}" for name in names)],
                 rows)


def times(results: Results, name: str) -> str:
    """Run time and memory of all methods."""
    facts = results.bench(name)
    gpu = facts["device"] != "cpu"
    rows = []
    for row in [row for row in choices(facts["methods"]) if not row["alone"]]:
        time = row["time"]
        span = f"{time['wall_ms_min']:.0f} to {time['wall_ms_max']:.0f}"
        rows.append([method_title(row["name"]), f"{time['wall_ms']:.0f}", span,
                     f"{time['cpu_s']:.3f}",
                     *([number(time["gpu_ms"], ".2f")] if gpu else []), f"{time['peak_mb']:.0f}"])
    return table(["method", "ms a frame", "least to most", "CPU s", *(["GPU ms"] if gpu else []),
                  "peak MB"], rows)


def ablations(results: Results, model: str, *names: str) -> str:
    """Loss without each plane: PSNR and flicker against the same network with all planes."""
    found = {name: {entry["name"].removeprefix(f"{model}-without-"): entry
                    for entry in results.ablations(name) if entry["of"] == model} for name in names}
    empty = [name for name, entries in found.items() if not entries]
    if empty:
        raise Missing(f"{empty[0]} has no ablations of {model}")
    planes = dict.fromkeys(plane for entries in found.values() for plane in entries)
    ordered = sorted(planes, key=lambda plane: plane == "all")
    rows = [[plane.replace("_", " ") if plane != "all" else "all: colour only",
             *(_loss(entries.get(plane)) for entries in found.values())] for plane in ordered]
    return table(["without", *map(place, names)], rows)


def _loss(entry: Facts | None) -> str:
    if entry is None:
        return "not in the files"
    return (f"{number(entry['psnr_late'], '+.2f')} dB, flicker "
            f"{number(entry['flicker_late'], '.2f', 'x')}")


def _by_network(benches: dict[str, Facts], cell: Any) -> str:
    networks = dict.fromkeys(row["name"] for facts in benches.values()
                             for row in facts["methods"] if is_network(row))
    rows = [[method_title(network), *(cell(facts, network) for facts in benches.values())]
            for network in networks]
    rows = [row for row in rows if set(row[1:]) != {"-"}]
    if not rows:
        raise Missing("the methods that it compares were not measured")
    return table(["network", *map(place, benches)], rows)


def _benches(results: Results, names: tuple[str, ...]) -> dict[str, Facts]:
    return {name: results.bench(name) for name in names}


def _row(facts: Facts, name: str) -> Facts | None:
    return next((row for row in facts["methods"] if row["name"] == name), None)


def _score(row: Facts, figure: str) -> float | None:
    return row["scores"][f"{figure}_late"]


def _best(rows: list[Facts], figure: str) -> Facts | None:
    """The row that is best in a figure."""
    found = None
    most: float | None = None
    for row in rows:
        score = _score(row, figure)
        if score is not None and (most is None or is_better(f"{figure}_late", score, most)):
            found, most = row, score
    return found


def _difference(one: float | None, other: float | None) -> float | None:
    """None where one of the two is unknown."""
    return None if one is None or other is None else one - other


def _ratio(one: float | None, other: float | None) -> float | None:
    """None where one of the two is unknown, or there is nothing to divide by."""
    return None if one is None or not other else one / other


def _figure(row: Facts, figure: str, best: Facts | None) -> str:
    """A figure, bold if it reads the same as the best one."""
    text = number(_score(row, figure), FORMS[figure])
    return bold(text, best is not None and text == number(_score(best, figure), FORMS[figure]))


def _gain(facts: Facts, network: str, figure: str) -> float | None:
    found = next((entry for entry in facts["against_best_baseline"] if entry["name"] == network),
                 None)
    return found[f"{figure}_late"] if found else None


def _mean(values: list[float | None], form: str, unit: str) -> str:
    """Mean over the known values; the text gives their number if some are unknown."""
    known = [value for value in values if value is not None]
    if not known:
        return "-"
    text = number(sum(known) / len(known), form, unit)
    return text if len(known) == len(values) else f"{text} ({len(known)} of {len(values)})"


# The validation set, held-out views and the networks ----------------------------------------------

COMPARED = {"psnr_late": FORMS["psnr"], "gain": "+.2f", "ssim_late": FORMS["ssim"],
            "flip_ratio": ".2f", "flicker_ratio": ".2f"}
PLAIN = ("cubic", "accumulation")
"""Methods of studies that are not networks but have names of one word."""
HEADS = ["PSNR", "gain, dB", "SSIM", "FLIP x", "flicker x"]


def scales(results: Results) -> str:
    """Our networks against OIDN at each scale: means over the clips, the worst clip and single
    frames."""
    facts = results.validation()
    rows = []
    by_scale = sorted(facts["scales"].items(), key=lambda item: _of(facts, item[0])[0]["scale"])
    for render, found in by_scale:
        own, scale = _of(facts, render), f"{_of(facts, render)[0]['scale']:g}x"
        for row in _best_of_oidn(found) + [row for row in found if is_network(row, "method")]:
            rows.append([scale, *_cells(row), number(row["least_gain"], "+.2f"),
                         number(row["worst_frame"], "+.2f"), _frames_below(own, row["method"])])
            scale = ""
    if not rows:
        raise Missing("the validation set was measured at no scale")
    return table(["scale", "method", *HEADS, "worst clip, dB", "worst frame, dB", "frames below"],
                 rows)


def equal_rays(results: Results) -> str:
    """Table of as many light paths spent at half and at full size, against the best of OIDN at full
    size."""
    facts = results.validation()
    if not facts["equal_rays"]:
        raise Missing("the validation set was not measured both ways with OIDN")
    ways: dict[str, list[Facts]] = {}
    for row in facts["equal_rays"]:
        name, _, way = row["method"].partition(" (")
        ways.setdefault(way.rstrip(")"), []).append({**row, "method": name})
    rows = []
    for way in reversed(ways):
        title = way
        for row in _best_of_oidn(ways[way]) + [row
                                               for row in ways[way] if is_network(row, "method")]:
            rows.append([title, *_cells(row), str(row["clips"])])
            title = ""
    return table(["rendered at", "method", *HEADS, "scenes"], rows)


def equivalent(results: Results, *names: str) -> str:
    """The samples a pixel that reach the error of a method with one sample."""
    rows = []
    for name in names:
        facts = results.equivalent(name)
        view = f"{facts['scene']}, seed {facts['seed']}"
        for method, found in facts["results"].items():
            counts = found["equivalent_samples"]
            cells = [f"over {facts['counts'][-1]}" if count is None else f"{count:.1f}"
                     for count in counts.values()]
            rows.append([view, _told(method), *cells,
                         str(found["images"])])
            view = ""
    return table(["view", "method", "by the error that is seen", "by relMSE", "images"], rows)


def convergence(results: Results, *names: str) -> str:
    """A method's least gain over its own input, of all sample counts, and its gain at the most
    samples."""
    rows = []
    for name in names:
        facts = results.convergence(name)
        view, found = f"{facts['view']['scene']}, seed {facts['view']['seed']}", facts["rows"]
        for scale, method in dict.fromkeys((row["scale"], row["method"])
                                           for row in found if row["method"] != "input"):
            own = [row for row in found if (row["scale"], row["method"]) == (scale, method)]
            least = min(own, key=lambda row: row["gain"])
            most = max(own, key=lambda row: row["samples"])
            rows.append([view, f"{scale}x", _told(method),
                         f"{number(least['gain'], '+.2f')} dB at {least['samples']}",
                         f"{number(most['gain'], '+.2f')} dB at {most['samples']}"])
            view = ""
    return table(["view", "scale", "method", "least gain over the input", "at the most samples"],
                 rows)


def networks(results: Results) -> str:
    """Size, training and validation of the networks, from their cards."""
    rows = []
    for card in results.cards():
        config, training = card["config"], card["training"]
        name = card["tag"].replace(".guides", " with guides").replace(".1x", " at 1x")
        length = (f"{training['steps']} of {training['batch']} windows, {training['minutes']:.0f} "
                  "minutes")
        length += f", {training['gpus']} GPU{'s' if training['gpus'] > 1 else ''}"
        rows.append([f"postfx {name}", _channels(config), str(config.get("depth", "")),
                     f"{card['parameters'] / 1e6:.2f} M", length, str(training["clips"]),
                     f"{training['validation_psnr']:.2f} dB",
                     f"{1000 * training['validation_flicker']:.1f}"])
    return table(["network", "channels", "convolutions a level", "parameters", "steps", "clips",
                  "held-out clips: PSNR", "flicker"], rows)


def _channels(config: Facts) -> str:
    """Channels by level; those of networks that give the picture differ on the way down and up."""
    if config.get("picture"):
        return ", ".join(f"{way} {'/'.join(map(str, config[way]))}" for way in ("down", "up"))
    stem = [f"stem {config['stem']}"] if config.get("stem") else []
    return ", ".join([*stem, "/".join(map(str, config["widths"]))])


def _told(method: str) -> str:
    """A method of a study for readers: networks have tags, as 'm' or 'm, alone'; names of others
    have spaces."""
    tag = method.split(",")[0]
    return method if " " in tag or tag in PLAIN else f"postfx {method}"


def _of(facts: Facts, render: str) -> list[Facts]:
    return [row for row in facts["rows"] if row["render"] == render]


def _best_of_oidn(rows: list[Facts]) -> list[Facts]:
    """The OIDN method with the greatest PSNR, as a list; empty if none was measured."""
    return sorted((row for row in rows if row["family"] == "oidn"),
                  key=lambda row: -row["psnr_late"])[:1]


def _cells(row: Facts) -> list[str]:
    return [method_title(row["method"]),
            *(number(row[key], form) for key, form in COMPARED.items())]


def _frames_below(rows: list[Facts], method: str) -> str:
    """The number of frames of all clips whose PSNR is below OIDN high's."""
    theirs: dict[str, Any] = {row["scene"]: row["psnr_frames"]
                              for row in rows if row["method"] == FRAMEWISE}
    pairs = [pair for row in rows if row["method"] == method and row["scene"] in theirs
             for pair in zip(row["psnr_frames"], theirs[row["scene"]], strict=True)]
    return f"{sum(one < other for one, other in pairs)} of {len(pairs)}" if pairs else "-"


# All of them, by name -----------------------------------------------------------------------------

MAKERS: dict[str, Callable[..., str]] = {
    "conditions": conditions,
    "gains": gains,
    "methods": methods,
    "frames": frames,
    "history": history,
    "front": front,
    "times": times,
    "ablations": ablations,
    "scales": scales,
    "equal_rays": equal_rays,
    "equivalent": equivalent,
    "convergence": convergence,
    "networks": networks,
}
"""Name -> the function that makes a block's lines from the results and the marker's arguments;
raises Missing."""
