"""Profiles of any content are taken or refused in one line that names the table and the key."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import postfx
from postfx.errors import ProfileError
from postfx.io.profile import load_profile

PLANE = '[[plane]]\nrole = "motion"\nchannels = ["XY"]\n'
MALFORMED = {
    "detect = 1": "detect must be tables in double brackets",
    "[detect]\nchannels = ['R']": "detect must be tables in double brackets",
    "[[detect]]\nheader = ['Software']": r"\[\[detect\]\]: header must be a table of regular "
    r"expressions",
    "[[detect]]\nheader = { Software = '(' }": "header must be a table of regular expressions",
    "[[detect]]\nchannels = 'R'": "channels must be a list of texts",
    "camera = 3": "camera must be a table",
    "[camera]\nfov_x = 'wide'": r"\[camera\]: fov_x must be a number",
    "[camera]\nfov_x = nan": "fov_x must be a number",
    "[camera]\nnear = true": "near must be a number",
    "[camera]\nshutter = 0": "shutter must be a number above 0",
    "[camera]\nmax_velocity = -2": "max_velocity must be a number above 0",
    "source = 'hearsay'": "source = 'hearsay': use one of file, code, listing, manual",
    "[[detect]]\nwithout = 'R'": "without must be a list of texts",
    PLANE + "requires = 'R'": "requires must be a list of texts",
    PLANE + "per = 'second'": "per = 'second': use one of frame, shutter",
    "header = []": "header must be a table",
    "[header]\nsamples = 'spp'": r"\[header\]: samples must be a list of texts",
    "name = 5": "name must be a text",
    "extends = ['generic']": "extends must be a text",
    "extends = 'nothing'": "unknown profile 'nothing'",
    "plane = { role = 'motion' }": "plane must be tables",
    PLANE + "scale = 'x'": "scale must be a list of numbers",
    PLANE + "scale = [1, 2, 3]": "scale needs 1 or 2 numbers",
    PLANE + "offset = []": "offset needs 1 or 2 numbers",
    PLANE + "clamp = [1]": "clamp must be two numbers, the lower first",
    PLANE + "clamp = [1, 0]": "clamp must be two numbers, the lower first",
    PLANE + "unit = ['uv']": "unit must be a text",
    PLANE + "names = 'mv'": "names must be a list of texts",
    PLANE + "miss = 'far'": "miss must be a number",
    "[[plane]]\nrole = 7": "role must be a text",
    "a = " + "[" * 5000: "nested without end|not valid TOML",
    "a" + ".a" * 50000 + " = 1": "a line of more than 200 dots",
    "#" * (1 << 19): "it has more than 262144 bytes",
}


@pytest.mark.parametrize("text", MALFORMED, ids=range(len(MALFORMED)))
def test_malformed_profiles_are_refused_in_one_line(tmp_path: Path, text: str) -> None:
    path = tmp_path / "studio.toml"
    path.write_text(text)
    with pytest.raises(ProfileError, match=MALFORMED[text]) as caught:
        load_profile(str(path))
    assert "\n" not in str(caught.value)


def test_a_byte_order_mark_is_no_part_of_a_profile(tmp_path: Path) -> None:
    path = tmp_path / "studio.toml"
    path.write_bytes(b"\xef\xbb\xbfextends = 'generic'\r\ntitle = 'Studio'\r\n")
    assert load_profile(str(path)).title == "Studio"


READS_NOISY = ('name = "our farm"\n[[plane]]\nrole = "colour"\nnames = ["noisy"]\n'
               'channels = ["RGB"]\n')


@pytest.mark.parametrize("name", ["studio", "our farm", "studio.toml"])
def test_a_profile_extends_one_beside_it_by_its_name(tmp_path: Path, write_exr, name: str) -> None:
    (tmp_path / "studio.toml").write_text(READS_NOISY)
    (tmp_path / "broken.toml").write_text("[")
    (tmp_path / "show.toml").write_text(f'extends = "{name}"\n[camera]\nnear = 0.5\n')
    frame = write_exr("a.0001.exr", {f"noisy.{letter}": np.full((8, 8), 0.5) for letter in "RGB"})
    shot = postfx.read_sequence(frame, profile=str(tmp_path / "show.toml"))
    assert (shot.read(1)["colour"] == 0.5).all()
    assert load_profile(str(tmp_path / "show.toml")).near == 0.5


def test_a_base_that_is_nowhere_is_told_with_the_file_that_asks_for_it(tmp_path: Path) -> None:
    path = tmp_path / "show.toml"
    path.write_text('name = "studio"\nextends = "studio"')
    with pytest.raises(ProfileError) as caught:
        load_profile(str(path))
    told = str(caught.value)
    assert told.startswith(f"{path}: extends: unknown profile 'studio'") and "\n" not in told
    assert told.endswith(f"or by its name if it lies in {tmp_path}")


def test_a_profile_that_extends_itself(tmp_path: Path) -> None:
    path = tmp_path / "studio.toml"
    path.write_text(f'extends = "{path}"')
    with pytest.raises(ProfileError, match="extends itself"):
        load_profile(str(path))


def test_a_profile_that_is_no_text(tmp_path: Path) -> None:
    (tmp_path / "studio.toml").write_bytes(b"\xff\xfe\0")
    with pytest.raises(ProfileError, match="not valid TOML"):
        load_profile(str(tmp_path / "studio.toml"))
