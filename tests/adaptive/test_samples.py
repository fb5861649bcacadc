"""Where a shot needs more samples: plans, estimates, and the verb `postfx samples`."""

import json
from pathlib import Path

import numpy as np
import pytest

from postfx.cli.main import main
from postfx.colour.views import to_codes
from postfx.errors import FrameError, OptionError
from postfx.frame import Frame, Role
from postfx.io.image_file import ImageFile
from postfx.io.writer import write_channels
from postfx.tools.adaptive.estimate import (
    error_of_half,
    estimate_error,
    estimate_from_halves,
    mean_frame,
    read_error,
)
from postfx.tools.adaptive.plan import (
    FEWEST_SAMPLES,
    MOST_SAMPLES_FACTOR,
    SLOPE,
    Region,
    Tiles,
    find_regions,
    look_ahead,
    make_tiles,
    parse_quality,
    plan_samples,
    spread,
)

ROOM = Path(__file__).resolve().parents[2] / "samples/room"


def tiles_of(errors, samples=4.0, side=32, number=1, seconds=None) -> Tiles:
    errors = np.array(errors, np.float64)
    size = errors.shape[1] * side, errors.shape[0] * side
    return Tiles(number, size, side, errors, np.full(errors.shape, samples),
                 np.full(errors.shape, side**2), seconds)


def total(shot, plan) -> float:
    return sum(float((tiles.error_with(more) * tiles.counted).sum())
               for tiles, more in zip(shot, plan, strict=True))


def test_words_decibels_and_flip_name_a_quality():
    assert parse_quality("visible").psnr == pytest.approx(36)
    assert parse_quality("38dB").psnr == parse_quality("38 db").psnr == pytest.approx(38)
    assert parse_quality("flip=0.052").psnr == pytest.approx(36, abs=0.2)
    assert parse_quality("flip=0.04").psnr > parse_quality("flip=0.06").psnr
    for text in ("good", "5dB", "flip=0", "38"):
        with pytest.raises(OptionError, match="give draft, visible, fine"):
            parse_quality(text)


def test_a_tile_gets_what_its_quality_needs():
    quality = parse_quality("36dB")
    tiles = tiles_of([[quality.error / 2, quality.error * 2, quality.error * 1e4]])
    (more,) = plan_samples([tiles], quality)
    exact = 4 * (2 ** (1 / SLOPE) - 1)
    assert (more[0, 0] == 0 and exact <= more[0, 1] < 2 * exact
            and more[0, 2] == 4 * MOST_SAMPLES_FACTOR)
    assert tiles.error_with(more)[0, 1] <= quality.error


def test_tiles_at_the_border_are_smaller_and_masked_ones_get_nothing():
    error = np.full((40, 50), 1e-2, np.float32)
    strength = np.ones_like(error)
    strength[:32, :32] = 0
    tiles = make_tiles(1, error, 4, strength, 32)
    assert (tiles.areas.tolist() == [[1024, 576], [256, 144]]
            and tiles.counted.tolist() == [[0, 576], [256, 144]])
    (more,) = plan_samples([tiles], parse_quality("36dB"))
    assert more[0, 0] == 0 and (more.ravel()[1:] > 0).all()
    assert spread(tiles, more).shape == (40, 50)


def test_a_pixel_that_is_not_finite_does_not_count():
    error = np.full((32, 32), 1e-3, np.float32)
    error[3, 4] = np.nan
    assert make_tiles(1, error, 4, None, 32).errors[0, 0] == pytest.approx(1e-3)


@pytest.mark.parametrize("budget", [1.0, 4.0, 9.0])
def test_a_budget_is_kept_and_lowers_the_error_more_than_even_samples(budget: float):
    random = np.random.default_rng(1)
    shot = [tiles_of(10 ** random.uniform(-5, -1.5, (6, 8)), random.integers(2, 9), number=n)
            for n in range(4)]
    plan = plan_samples(shot, parse_quality("60dB"), budget)
    used = np.mean([more.mean() for more in plan])
    even = [np.full_like(more, used) for more in plan]
    assert budget / 2.5 < used <= budget and total(shot, plan) < 0.9 * total(shot, even)


def test_the_budget_of_a_shot_goes_to_its_worst_frames():
    shot = [tiles_of(np.full((4, 4), 1e-4)), tiles_of(np.full((4, 4), 1e-2), number=2)]
    good, bad = plan_samples(shot, parse_quality("50dB"), 8)
    assert bad.mean() > 10 and good.mean() < bad.mean() / 3


def test_more_budget_than_needed_changes_nothing():
    shot = [tiles_of([[1e-3, 1e-5]])]
    quality = parse_quality("36dB")
    np.testing.assert_array_equal(plan_samples(shot, quality, 1e6)[0],
                                  plan_samples(shot, quality)[0])


def test_the_outlook_compares_with_even_samples_and_tells_hours():
    quality = parse_quality("36dB")
    shot = [tiles_of([[1e-2, 1e-5], [1e-5, 1e-5]], 4, seconds=3600)]
    plan = plan_samples(shot, quality)
    found = look_ahead(shot, plan, quality)
    assert found.more == plan[0].mean() and found.uniform > 2 * found.more
    assert (found.hours == pytest.approx(found.more / 4)
            and found.uniform_hours == pytest.approx(found.uniform / 4))
    assert found.after < found.now
    even = [np.full((2, 2), found.uniform)]
    assert total(shot, even) == pytest.approx(total(shot, plan), rel=1e-3)


def test_regions_cover_exactly_the_tiles_that_get_samples():
    random = np.random.default_rng(2)
    tiles = make_tiles(1, np.ones((100, 150), np.float32), 4, None, 32)
    more = random.choice([0.0, 4.0, 8.0], tiles.errors.shape)
    painted = np.zeros((100, 150))
    regions = find_regions(tiles, more)
    for region in regions:
        rows = slice(region.y, region.y + region.height)
        columns = slice(region.x, region.x + region.width)
        assert not painted[rows, columns].any()
        painted[rows, columns] = region.samples
    np.testing.assert_array_equal(painted, spread(tiles, more))
    whole = find_regions(tiles, np.full(tiles.errors.shape, 8.0))
    assert whole == [Region(0, 0, 150, 100, 8)]


def noisy_frame(sigma: np.ndarray, seed: int = 1) -> tuple[Frame, np.ndarray]:
    """A grey frame with noise, and a denoised one with the hundredth part of its variance."""
    noise = np.random.default_rng(seed).normal(0, 1, (*sigma.shape, 3)) * sigma[..., None]
    grey = np.full((*sigma.shape, 3), 0.3)
    return (Frame({Role.COLOUR: np.float32(grey + noise)}), np.float32(grey + noise / 10))


def test_the_estimate_is_higher_where_there_is_more_noise_and_keeps_its_place():
    sigma = np.full((64, 128), 0.01)
    sigma[:, 64:] = 0.1
    frame, denoised = noisy_frame(sigma)
    error = estimate_error(frame, denoised, 1.0)
    assert error.shape == (64, 128) and error.dtype == np.float32
    assert error[:, 80:].mean() > 20 * error[:, :48].mean()
    with pytest.raises(FrameError, match="denoise it at the render's size"):
        estimate_error(frame, denoised[:32], 1.0)


def denoised_halves(bias: float, seed: int = 1) -> tuple:
    """A picture, two halves of its samples, and what a denoiser makes of each and of both: it keeps
    a part of the noise, and is wrong by a pattern, which is smaller with all samples."""
    random, rows = np.random.default_rng(seed), np.arange(128)
    truth = np.full((128, 128, 3), 0.3)
    wrong = bias * np.sin(rows / 3)[:, None, None] * np.linspace(0, 2, 128)[:, None]
    noises = [random.normal(0, 0.1, truth.shape) for _ in range(2)]
    halves = truth + noises[0], truth + noises[1]
    both = (noises[0] + noises[1]) / 2
    return truth, halves, (*(truth + wrong + 0.3 * noise for noise in noises),
                           truth + 0.7 * wrong + 0.3 * both)


@pytest.mark.parametrize("bias", [0.0, 0.05])
def test_halves_measure_noise_and_bias_of_the_denoiser(bias: float):
    truth, halves, denoised = denoised_halves(bias)
    measured = np.square(to_codes(denoised[0], 1.0) - to_codes(truth, 1.0)).mean(axis=2)
    found = error_of_half(halves, denoised[:2], 1.0, 64)
    wanted = make_tiles(1, np.float32(measured), 4, None, 64).errors
    assert found.mean() == pytest.approx(wanted.mean(), rel=0.15)
    # neighbours count, too
    assert np.abs(np.log(found / wanted)).max() < np.log(1.25 if bias == 0 else 1.7)


def test_halves_tell_the_error_of_both_together_and_fireflies_do_not_decide():
    truth, halves, denoised = denoised_halves(0.05)
    measured = np.square(to_codes(denoised[2], 1.0) - to_codes(truth, 1.0)).mean()
    plain = estimate_from_halves(halves, denoised, 1.0, 32).mean()
    assert 0.5 < plain / measured < 2
    halves[0][5, 5] = 1e5
    assert estimate_from_halves(halves, denoised, 1.0, 32).mean() == pytest.approx(plain, rel=0.1)
    with pytest.raises(FrameError, match="several sizes"):
        estimate_from_halves(halves, (denoised[0], denoised[1], denoised[2][:64]), 1.0, 32)


def test_two_renders_are_averaged_but_for_depth_and_motion():
    one, other = (Frame({Role.COLOUR: np.full((4, 4, 3), value, np.float32),
                         Role.DEPTH: np.full((4, 4, 1), value, np.float32)}, samples=4)
                  for value in (1.0, 3.0))
    mean = mean_frame(one, other)
    assert (mean[Role.COLOUR] == 2).all() and (mean[Role.DEPTH] == 1).all()
    assert (one[Role.COLOUR] == 1).all()


def test_a_quality_in_flip_spreads_a_budget_more_evenly_than_one_in_decibels():
    shot = [tiles_of([[1e-2, 1e-3]])]
    by_flip, by_decibels = (plan_samples(shot, parse_quality(text), 10)[0][0]
                            for text in ("flip=0.001", "70dB"))
    assert (by_decibels[0] >= by_flip[0] >= FEWEST_SAMPLES
            and by_flip[1] >= FEWEST_SAMPLES > by_decibels[1])


def test_the_estimate_orders_the_tiles_of_real_renders(shared_dir: Path):
    """Of other people's scenes at the render's size: by tiles, against the measured error."""
    import postfx
    from postfx.tools.bench.metrics import grey_factor

    logs = []
    pipeline = postfx.Pipeline([postfx.DenoiseUpscale(scale=1.0, model="s")])
    for name in ("water_1x4", "snow_1x16"):
        frame = postfx.read_sequence(shared_dir / f"sequences/{name}/noisy.0002.exr").read(2)
        reference = (postfx.read_sequence(shared_dir / f"sequences/{name}/reference.0002.exr")
                     .read(2)[Role.COLOUR])
        denoised, exposure = pipeline(frame)[Role.COLOUR], grey_factor(reference)
        pipeline.reset()
        true = np.square(to_codes(denoised, exposure) - to_codes(reference, exposure)).mean(axis=2)
        pair = [make_tiles(1, np.float32(error), 4, None, 32).errors.ravel()
                for error in (true, estimate_error(frame, denoised, exposure))]
        logs.append(np.log10(pair))
    measured, predicted = np.concatenate(logs, axis=1)
    assert np.corrcoef(measured, predicted)[0, 1] > 0.7
    assert np.abs(measured - predicted).mean() < 0.45


def test_the_plane_error_of_a_file_counts(tmp_path: Path, capsys):
    error = np.full((64, 64), 1e-5, np.float32)
    error[32:, :32] = 1e-2
    colour = {name: np.full((64, 64), 0.2) for name in "RGB"}
    write_channels(tmp_path / "shot.0001.exr", {**colour, "error.Y": error}, {"postfx:spp": 4})
    np.testing.assert_array_equal(read_error(tmp_path / "shot.0001.exr"), error)
    words = ["samples", f"{tmp_path}/shot.####.exr", "-o", f"{tmp_path}/map/####.exr", "--json"]
    assert main(words) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["error_from"] == ["the AOV 'error'"] and facts["frames"][0]["samples"] == 4
    (region,) = facts["frames"][0]["regions"]
    assert region | {"samples": 0} == {"x": 0, "y": 32, "width": 32, "height": 32, "samples": 0}
    assert region["samples"] == 4 * MOST_SAMPLES_FACTOR
    for seconds, told in (("0.5", " s in place of "), ("900", " min in place of "),
                          ("9000", " hours in place of ")):
        assert main([*words[:2], "-o", f"{tmp_path}/{seconds}.exr", "--seconds", seconds]) == 0
        assert told in capsys.readouterr().out
    assert main([*words[:2], "--profile", "generic", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["frames"] == facts["frames"]
    with ImageFile(tmp_path / "map/0001.exr") as file:
        found = file.read(file.parts[0], {"samples.Y": 0, "error.Y": 0, "after.Y": 0})
    assert (found["samples.Y"][40, 3] == 4 * MOST_SAMPLES_FACTOR
            and found["samples.Y"].sum() == 4 * MOST_SAMPLES_FACTOR * 1024)
    assert found["error.Y"][40, 3] == pytest.approx(1e-2) and found["after.Y"][40, 3] < 5e-3
    assert main(words) == 2
    told = capsys.readouterr().err
    assert "is already there: give --overwrite" in told and "--skip-existing" not in told


def test_two_halves_of_a_shot_are_one_with_all_samples(tmp_path: Path, capsys):
    random = np.random.default_rng(1)
    names = [str(write_channels(tmp_path / f"seed{seed}.0001.exr",
                                {name: 0.3 + random.normal(0, 0.1, (64, 64)) for name in "RGB"},
                                {"postfx:spp": 8}))
             for seed in (1, 2)]
    words = ["samples", names[0], "--halves", names[1], "--model", "s", "--json"]
    assert main(words) == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["error_from"] == ["two halves of the samples"]
            and facts["frames"][0]["samples"] == 16)
    assert main([*words[:4], "--json"]) == 0
    assert ", as 'postfx run' does; --denoised takes the frames that" in capsys.readouterr().err
    assert main([*words, "--profile", "generic"]) == 0
    assert json.loads(capsys.readouterr().out)["frames"] == facts["frames"]
    assert main([*words, "--denoised", names[0], names[1]]) == 2
    assert "with --halves three" in capsys.readouterr().err
    assert main([*words, "--error", names[0]]) == 2
    assert "both tell the error" in capsys.readouterr().err
    assert main(["samples", names[0], "--halves", names[0], "--model", "s", "--json"]) == 2
    assert "has the same noise as" in capsys.readouterr().err
    other = str(write_channels(tmp_path / "other.0001.exr",
                               {name: 0.9 + random.normal(0, 0.1, (64, 64)) for name in "RGB"},
                               {"postfx:spp": 8}))
    assert main(["samples", names[0], "--halves", other, "--model", "s", "--json"]) == 2
    assert "shows another picture than" in capsys.readouterr().err


def test_a_shot_is_denoised_and_planned_with_pictures_and_a_mask(tmp_path: Path, capsys):
    shot = str(ROOM / "noisy.####.exr")
    assert main(["samples", shot, "--frames", "1-2", "--model", "s", "--pictures", str(tmp_path),
                 "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert [frame["frame"] for frame in facts["frames"]] == [1, 2]
    assert facts["error_from"] == ["an estimate from the noise"]
    assert (0 < facts["more_samples"] < facts["uniform_samples"]
            and facts["psnr_after"] > facts["psnr"])
    assert (tmp_path / "samples.0002.png").read_bytes()[:4] == b"\x89PNG"
    assert main(["samples", shot, "--frames", "1-2", "--model", "s", "--leave", "converged:1spp",
                 "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["more_samples"] == 0


def test_what_cannot_be_planned_is_said_in_one_line(tmp_path: Path, capsys):
    colour = {name: np.full((64, 64), 0.2) for name in "RGB"}
    silent = str(write_channels(tmp_path / "silent.exr", colour))
    shot = str(ROOM / "noisy.0001.exr")
    for words, message in (([shot], "nowhere to write"),
                           ([shot, "--json", "--quality", "nice"], "--quality nice: give draft"),
                           ([shot, "--json", "--tile", "2"], "too small to render"),
                           ([shot, "--json", "--error", shot], "no AOV 'error'"),
                           ([silent, "--json", "--model", "s"], "give --samples N"),
                           ([shot, "-o", str(tmp_path / "map.png")], "maps are EXR files")):
        assert main(["samples", *words]) == 2
        errors = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error")]
        assert len(errors) == 1 and message in errors[0]


def test_few_samples_are_not_worth_a_render():
    quality = parse_quality("36dB")
    (more,) = plan_samples([tiles_of([[quality.error * 1.05, quality.error * 1.5]], 4)], quality)
    assert more[0, 0] == 0 and more[0, 1] >= FEWEST_SAMPLES
