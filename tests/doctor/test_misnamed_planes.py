"""Layers with unusual names are named by the finding of the plane that is missing."""

import json

import numpy as np
import pytest

from postfx.cli.main import main
from postfx.frame import Role
from postfx.io.sequence import read_sequence

LAYERS = {
    "albdo": ("RGB", Role.DIFFUSE_ALBEDO),
    "nrm": ("XYZ", Role.NORMAL),
    "vel": ("XY", Role.MOTION),
    "dpth": ("Z", Role.DEPTH),
}


@pytest.mark.parametrize("layer", LAYERS)
def test_misnamed_plane_has_a_profile(write_exr, tmp_path, capsys, layer):
    letters, role = LAYERS[layer]
    values = np.random.default_rng(1).random((32, 48), np.float32)
    names = [*"RGB", *(f"{layer}.{letter}" for letter in letters), "P.X", "P.Y", "P.Z",
             "crypto00.R", "crypto00.G", "crypto00.B", "crypto00.A",
             "spec_albdo.R", "spec_albdo.G", "spec_albdo.B"]
    for number in (1, 2):
        write_exr(f"a.{number}.exr", dict.fromkeys(names, values))
    main(["inspect", str(tmp_path / "a.#.exr"), "--json"])
    found = json.loads(capsys.readouterr().out)["findings"]
    code = f"missing-{role.replace('_', '-')}"
    missing = [one for one in found if one["code"].startswith("missing-")]
    assert not any("P.X" in one["evidence"] or "crypto" in one["evidence"] for one in missing)
    assert not any("spec_albdo" in one["evidence"] for one in missing)
    (finding,) = [one for one in found
                  if one["code"] == code and f"{layer}." in one["evidence"]]
    (tmp_path / "own.toml").write_text(finding["fix"].partition(":\n")[2])
    first = next(iter(read_sequence(tmp_path / "a.#.exr", profile=str(tmp_path / "own.toml"))))
    assert role in first


def missing_colour(arguments, capsys):
    """The finding of `postfx inspect` on a sequence without a colour."""
    assert main(["inspect", *map(str, arguments), "--json"]) == 2
    found = json.loads(capsys.readouterr().out)["findings"]
    (finding,) = [one for one in found if one["code"] == "missing-colour"]
    return finding


def channels_of(layers):
    """Channels of noise, each of its own: layer -> letters."""
    rng = np.random.default_rng(2)
    return {f"{layer}.{letter}": rng.random((32, 48), np.float32)
            for layer, letters in layers.items() for letter in letters}


@pytest.mark.parametrize(("layer", "letters"), [
    ("beuty_pass", "RGBA"), ("shot.final", "RGB"), ("wholly_else", "rgb")])
def test_a_misnamed_colour_has_a_profile(write_exr, tmp_path, capsys, layer, letters):
    channels = channels_of({"zap": "RGB", layer: letters, "albedo": "RGB", "nrm": "RGB",
                            "P": "XYZ", "crypto00": "RGBA"})
    path = write_exr("a.1.exr", channels)
    finding = missing_colour([path], capsys)
    listed = finding["evidence"].partition("not read: ")[2].split("; ")
    assert listed == [f"{layer}.{','.join(letters)}", "zap.R,G,B"]
    assert f"give --layer '{layer}', or write this into a file" in finding["fix"]
    (tmp_path / "own.toml").write_text(finding["fix"].partition(":\n")[2])
    expected = np.stack([channels[f"{layer}.{letter}"] for letter in letters], 2)
    for options in {"profile": str(tmp_path / "own.toml")}, {"layer": layer}:
        (frame,) = read_sequence(path, **options)
        found = [frame[role] for role in (Role.COLOUR, Role.ALPHA) if role in frame]
        np.testing.assert_array_equal(np.concatenate(found, 2), expected)
        assert Role.DIFFUSE_ALBEDO in frame
    main(["inspect", str(path)])
    shown = capsys.readouterr().out
    assert "\nmissing  colour\n" in shown and "optional colour" not in shown


def test_where_no_layer_may_be_the_colour_none_is_offered(write_exr, capsys):
    path = write_exr("a.1.exr", channels_of({"albdo": "RGB", "nrm": "RGB", "crypto00": "RGBA",
                                             "P": "RGB", "depth": "Z"}))
    finding = missing_colour([path], capsys)
    assert finding["evidence"] == "no colour AOV was found"
    assert finding["fix"] == "render it, or name it in a profile (--profile FILE.toml)"


def test_a_profile_that_is_offered_extends_the_users_own(write_exr, tmp_path, capsys):
    """By its path: its name may be that of a built-in one."""
    path = write_exr("a.1.exr", channels_of({"zap": "RGB", "beauties": "RGB", "gloss": "R"}))
    (tmp_path / "studio").mkdir()
    base = tmp_path / "studio" / "ours.toml"
    base.write_text('name = "generic"\n[[plane]]\nrole = "roughness"\nnames = ["gloss"]\n'
                    'channels = ["R"]\n')
    finding = missing_colour([path, "--profile", base], capsys)
    (tmp_path / "own.toml").write_text(finding["fix"].partition(":\n")[2])
    (frame,) = read_sequence(path, profile=str(tmp_path / "own.toml"))
    assert set(frame.planes) == {Role.COLOUR, Role.ROUGHNESS}
