"""Tables of the validation set, of held-out views and of the networks."""

from __future__ import annotations

from typing import Any

from training.measure.quality_report.errors import Missing
from training.measure.quality_report.markdown import FORMS, is_network, number, table, titled
from training.measure.quality_report.results import Facts, Results
from training.measure.validation.report import FRAMEWISE

COMPARED = {"psnr_late": FORMS["psnr"], "gain": "+.2f", "ssim_late": FORMS["ssim"], "flip_ratio": ".2f",
            "flicker_ratio": ".2f"}
PLAIN = ("cubic", "accumulation")
"""Methods of studies that are no networks and have names of one word."""
HEADS = ["PSNR", "gain, dB", "SSIM", "FLIP x", "flicker x"]


def scales(results: Results) -> str:
    """Our networks against OIDN at each scale: means over the clips, the worst clip and single frames."""
    facts = results.validation()
    rows = []
    by_scale = sorted(facts["scales"].items(), key=lambda item: _of(facts, item[0])[0]["scale"])
    for render, found in by_scale:
        own, scale = _of(facts, render), f"{_of(facts, render)[0]['scale']:g}x"
        for row in _best_of_oidn(found) + [row for row in found if is_network(row, "method")]:
            rows.append([scale, *_cells(row), number(row["least_gain"], "+.2f"), number(row["worst_frame"], "+.2f"),
                         _frames_below(own, row["method"])])
            scale = ""
    if not rows:
        raise Missing("the validation set was measured at no scale")
    return table(["scale", "method", *HEADS, "worst clip, dB", "worst frame, dB", "frames below"], rows)


def equal_rays(results: Results) -> str:
    """As many light paths spent both ways, against the best of OIDN at full size."""
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
        for row in _best_of_oidn(ways[way]) + [row for row in ways[way] if is_network(row, "method")]:
            rows.append([title, *_cells(row), str(row["clips"])])
            title = ""
    return table(["rendered at", "method", *HEADS, "scenes"], rows)


def equivalent(results: Results, *names: str) -> str:
    """How many samples a pixel reach the error that a method reaches with one."""
    rows = []
    for name in names:
        facts = results.equivalent(name)
        view = f"{facts['scene']}, seed {facts['seed']}"
        for method, found in facts["results"].items():
            counts = found["equivalent_samples"]
            cells = [f"over {facts['counts'][-1]}" if count is None else f"{count:.1f}" for count in counts.values()]
            rows.append([view, _told(method), *cells,
                         str(found["images"])])
            view = ""
    return table(["view", "method", "by the error that is seen", "by relMSE", "images"], rows)


def convergence(results: Results, *names: str) -> str:
    """Where a method gains least over its own input, of all sample counts, and what it gains at the most samples."""
    rows = []
    for name in names:
        facts = results.convergence(name)
        view, found = f"{facts['view']['scene']}, seed {facts['view']['seed']}", facts["rows"]
        for scale, method in dict.fromkeys((row["scale"], row["method"]) for row in found if row["method"] != "input"):
            own = [row for row in found if (row["scale"], row["method"]) == (scale, method)]
            least, most = min(own, key=lambda row: row["gain"]), max(own, key=lambda row: row["samples"])
            rows.append([view, f"{scale}x", _told(method),
                         f"{number(least['gain'], '+.2f')} dB at {least['samples']}",
                         f"{number(most['gain'], '+.2f')} dB at {most['samples']}"])
            view = ""
    return table(["view", "scale", "method", "least gain over the input", "at the most samples"], rows)


def networks(results: Results) -> str:
    """What the cards of the networks tell of their size, their training and their validation."""
    rows = []
    for card in results.cards():
        config, training = card["config"], card["training"]
        name = card["tag"].replace(".guides", " with guides").replace(".1x", " at 1x")
        length = f"{training['steps']} of {training['batch']} windows, {training['minutes']:.0f} minutes"
        length += f", {training['gpus']} GPU{'s' if training['gpus'] > 1 else ''}"
        stem = [f"stem {config['stem']}"] if "stem" in config and config["stem"] else []
        channels = ", ".join([*stem, "/".join(map(str, config["widths"]))])
        rows.append([f"postfx {name}", channels, str(config["depth"]),
                     f"{card['parameters'] / 1e6:.2f} M", length, str(training["clips"]),
                     f"{training['validation_psnr']:.2f} dB", f"{1000 * training['validation_flicker']:.1f}"])
    return table(["network", "channels", "convolutions a level", "parameters", "steps", "clips", "held-out clips: PSNR",
                  "flicker"], rows)


def _told(method: str) -> str:
    """A method of a study for readers: networks go by tag, as 'm' or 'm, alone'; what others are called has spaces."""
    tag = method.split(",")[0]
    return method if " " in tag or tag in PLAIN else f"postfx {method}"


def _of(facts: Facts, render: str) -> list[Facts]:
    return [row for row in facts["rows"] if row["render"] == render]


def _best_of_oidn(rows: list[Facts]) -> list[Facts]:
    """The OIDN method of the greatest PSNR, alone; none where it was not measured."""
    return sorted((row for row in rows if row["family"] == "oidn"), key=lambda row: -row["psnr_late"])[:1]


def _cells(row: Facts) -> list[str]:
    return [titled(row["method"]), *(number(row[key], form) for key, form in COMPARED.items())]


def _frames_below(rows: list[Facts], method: str) -> str:
    """How many frames of all clips have less PSNR than OIDN high's."""
    theirs: dict[str, Any] = {row["scene"]: row["psnr_frames"] for row in rows if row["method"] == FRAMEWISE}
    pairs = [pair for row in rows if row["method"] == method and row["scene"] in theirs
             for pair in zip(row["psnr_frames"], theirs[row["scene"]], strict=True)]
    return f"{sum(one < other for one, other in pairs)} of {len(pairs)}" if pairs else "-"
