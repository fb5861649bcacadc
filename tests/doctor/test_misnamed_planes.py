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
