"""What benchmarks would have written, made up: rows and files for docs/lab/quality.md's tables."""

from __future__ import annotations

from typing import Any

from postfx.tools.bench import report


def method(name: str, ms: float, psnr: float, flicker: float, family: str, first: float,
           **facts: Any) -> dict[str, Any]:
    """A row of bench.json: four frames of which the first has another PSNR than the mean of the
    second half."""
    figures = {"psnr": psnr, "ssim": psnr / 40, "flip": 1 / psnr, "relmse": 0.01,
               "flicker": flicker}
    time = {"wall_ms": ms, "wall_ms_min": ms - 1, "wall_ms_max": ms + 2, "cpu_s": ms / 500,
            "gpu_ms": None, "first_ms": 9.0, "peak_mb": 300.4}
    plain = {"title": name, "model": "", "precision": "fp32", "guides": False, "alone": False,
             "run_up": False, "both": False, "without": []}
    return {"name": name, "family": family, **plain, **facts, "time": time,
            "scores": {f"{key}_late": value for key, value in figures.items()},
            "frames": [{"frame": n + 1, "psnr": first if n == 0 else psnr} for n in range(4)]}


def bench(network: float, *more: dict[str, Any]) -> dict[str, Any]:
    """bench.json of a network of that PSNR, of OIDN at 30 dB and accumulated OIDN at 31 dB, and of
    what is given."""
    rows = [method("m", 60, network, 8, "ours", 29.5, model="m"),
            method("m-int8", 30, network - 0.1, 8.2, "ours", 29.5, model="m.int8",
                   precision="int8"),
            method("m-alone", 61, network - 2, 16, "ours", 29.5, model="m", alone=True),
            method("m-without-depth", 60, network - 0.4, 10, "ours", 29, model="m",
                   without=["depth"]),
            method("m-without-all", 60, network - 3, 20, "ours", 28, model="m",
                   without=["depth", "normal"]),
            method("oidn-high", 200, 30, 16, "oidn", 30),
            method("oidn-high-accumulated", 210, 31, 10, "oidn", 30),
            method("bicubic", 10, 17, 130, "plain", 17), *more]
    offered = report.choices(rows)
    return {"methods": rows, "device": "cpu", "threads": 2, "runs": 3,
            "machine": {"processor": "some CPU"}, "render_size": [32, 18], "output_size": [64, 36],
            "guides": ["depth"], "versions": {"pyoidn": "2.5"},
            "sequence": {"frames": [1, 2, 3, 4]}, "ablations": report.ablations(rows),
            "against_best_baseline": report.compare(offered),
            "fronts": {figure: report.front(offered, figure)
                       for figure in ("psnr_late", "flicker_late")}}


def comparison() -> dict[str, Any]:
    """comparison.json of two clips at two scales, by the code that writes it."""
    from training.measure.validation.compare import equal_rays, summary

    rows = []
    for render, scale in (("x2", 2.0), ("x1", 1.0)):
        for scene in ("room.1", "room.2"):
            for name, family, psnr in (("m", "ours", 30 - scale), ("m-alone", "ours", 20),
                                       ("oidn-high", "oidn", 27.5), ("bicubic", "plain", 15)):
                frames = [psnr - (3 if scene == "room.2" else 0), psnr]
                rows.append({"scene": scene, "render": render, "scale": scale, "method": name,
                             "family": family,
                             "wall_ms": 5.0, "psnr_late": psnr, "ssim_late": 0.8, "flip_late": 0.1,
                             "flicker_late": 9.0 if family == "ours" else 12.0,
                             "psnr_frames": frames})
    tables = {name: summary([row for row in rows if row["render"] == name])
              for name in ("x2", "x1")}
    return {"scales": tables, "equal_rays": equal_rays(tables), "rows": rows}
