"""Passes by networks of scenes: occlusion of any scene; irradiance and shading of one."""

from pathlib import Path

import numpy as np
import pytest

import postfx
from postfx import Device, Frame, Pipeline, Role, integrate
from postfx.errors import FrameError, ModelError, PassOptionError
from postfx.kernels.scene import POINT
from postfx.neural import Network
from postfx.passes import scene
from postfx.passes.scene import Irradiance, Occlusion, SceneShading, camera_of
from postfx.passes.scene_points import places_of, reflectance_of
from training import irradiance, train_scene

ROOM = Path(__file__).parents[2] / "samples/room"
SIZE = (40, 56)


@pytest.fixture(scope="module")
def device() -> Device:
    return Device("cpu", threads=2)


@pytest.fixture(scope="module")
def room() -> list[Frame]:
    """Frames of the sample room: 192x108 or so, with planes and camera."""
    return list(postfx.read_sequence(str(ROOM / "noisy.####.exr")))[:3]


def corner(**facts: object) -> Frame:
    """A floor that meets a wall: depth of the camera's axis, by a camera that looks at the edge
    from 3 above."""
    rows, columns = SIZE
    tangent = np.tan(np.radians(60) / 2)
    down = (np.arange(rows) + 0.5) / rows * 2 - 1
    slope = down * tangent * rows / columns
    floor = np.where(slope > 0, 1 / np.maximum(slope, 1e-6), np.inf)
    depth = np.minimum(floor, 4.0)[:, None] * np.ones((1, columns))
    normal = np.where((floor < 4)[:, None, None], (0.0, 1.0, 0.0),
                      (0.0, 0.0, -1.0)) * np.ones((1, columns, 1))
    planes = {Role.COLOUR: np.ones((*SIZE, 3), np.float32),
              Role.DEPTH: depth[..., None].astype(np.float32),
              Role.NORMAL: normal.astype(np.float32)}
    return Frame(planes, **{"world_to_camera": np.eye(4), "fov_x": 60.0, **facts})


def shade_of(frame: Frame, device: Device, **options: object) -> np.ndarray:
    return Pipeline([Occlusion(radius=1.0, **options)], device,
                    exposure=1.0)(frame)[Role.COLOUR][..., 0]


@pytest.mark.parametrize("network", [False, True])
def test_a_corner_is_dark_and_open_surfaces_are_not(device: Device, network: bool) -> None:
    """In the edge half of the hemisphere is hidden; GTAO is exact for two planes, but for its
    fade."""
    shade = shade_of(corner(), device, network=network)
    edge = int(np.argmax(corner()[Role.DEPTH][:, 0, 0] < 4))
    assert 0.4 < shade[edge, 28] < 0.8 and shade[edge - 1, 28] < 0.85
    assert shade[2, 28] > 0.95 and shade[-1, 28] > 0.9


def test_normals_come_from_depth_where_there_is_no_camera_or_no_plane(device: Device,
                                                                      caplog) -> None:
    usual = shade_of(corner(), device, network=False)
    planes = {role: plane for role, plane in corner().planes.items() if role is not Role.NORMAL}
    without_normals = shade_of(Frame(planes, world_to_camera=np.eye(4), fov_x=60.0), device,
                               network=False)
    blind = shade_of(corner(world_to_camera=None), device, network=False)
    assert np.abs(without_normals - usual).mean() < 0.02
    np.testing.assert_array_equal(blind, without_normals)
    assert "no camera in its file: occlusion takes normals from depth" in caplog.text


def test_turned_cameras_see_the_same(device: Device) -> None:
    """The world turned together with the camera."""
    turn = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
    frame, camera = corner(), np.eye(4)
    planes = dict(frame.planes) | {Role.NORMAL: (frame[Role.NORMAL] @ turn).astype(np.float32)}
    camera[:3, :3] = np.linalg.inv(turn)
    other = Frame(planes, world_to_camera=camera, fov_x=60.0)
    np.testing.assert_allclose(shade_of(other, device), shade_of(frame, device), atol=2e-3)


def test_gtao_is_chosen_where_no_network_can_run(device: Device, monkeypatch) -> None:
    wanted = shade_of(corner(), device, network=False)
    monkeypatch.setattr(scene, "has_networks", lambda: False)
    without = Occlusion(radius=1.0)
    shade = Pipeline([without], device, exposure=1.0)(corner())[Role.COLOUR][..., 0]
    np.testing.assert_array_equal(shade, wanted)
    assert without.choice == "gtao"
    monkeypatch.undo()
    with_network = Occlusion(radius=1.0)
    Pipeline([with_network], device, exposure=1.0)(corner())
    assert with_network.choice == "network"


def test_misses_and_broken_depth_are_left_alone(device: Device) -> None:
    frame = corner()
    frame.planes[Role.DEPTH][:5], frame.planes[Role.DEPTH][5, 3] = 1e10, np.nan
    shade = shade_of(frame, device)
    assert (shade[:4] == 1).all() and np.isfinite(shade).all()


@pytest.mark.parametrize(("options", "text"),
                         [({"radius": 0.0}, "radius 0"), ({"strength": 2.0}, "strength 2")])
def test_options_out_of_range_are_errors(options: dict, text: str) -> None:
    with pytest.raises(PassOptionError, match=text):
        Occlusion(**options)


def test_shading_is_what_the_network_computes(device: Device, room: list[Frame]) -> None:
    """As near to the reference as the page says: frames of the room at 25 dB and more."""
    way = Pipeline([SceneShading(model=str(ROOM / "shading.onnx"))], device, exposure=1.0)
    shaded = way(room[0])[Role.COLOUR]
    reference = next(iter(postfx.read_sequence(str(ROOM / "reference.####.exr"))))[Role.COLOUR]
    factor = reference.shape[0] // shaded.shape[0]
    truth = reference.reshape(shaded.shape[0], factor, shaded.shape[1], factor, 3).mean((1, 3))
    codes = [np.sqrt(np.maximum(light, 0) / (1 + np.maximum(light, 0)))
             for light in (shaded, truth)]
    assert -10 * np.log10(np.mean((codes[0] - codes[1]) ** 2)) > 25


@pytest.mark.parametrize("kind", ["shading", "amplifier", "temporal"])
def test_the_networks_of_the_room_make_no_light_that_is_not_there(
    kind: str, device: Device, room: list[Frame]
) -> None:
    """In a frame with lamps, whose codes tell little of how bright they are."""
    way = Pipeline([SceneShading(model=str(ROOM / f"{kind}.onnx"))], device, exposure=1.0)
    (reference,) = postfx.read_sequence(str(ROOM / "reference.####.exr"), "2")
    shaded, light = way(room[1])[Role.COLOUR], reference[Role.COLOUR]
    assert light.max() > 50
    assert shaded.max() < 1.2 * light.max()
    assert shaded.mean() == pytest.approx(light.mean(), rel=0.15)


def test_history_counts_until_it_is_dropped(device: Device, room: list[Frame]) -> None:
    kind = SceneShading(model=str(ROOM / "temporal.onnx"))
    way = Pipeline([kind], device, exposure=1.0)
    first, second = (way(frame)[Role.COLOUR] for frame in room[:2])
    again = Pipeline([SceneShading(model=str(ROOM / "temporal.onnx"))], device, exposure=1.0)
    assert kind.accumulates(postfx.FrameSpec(8, 8, (Role.COLOUR,)))
    assert not np.array_equal(again(room[1])[Role.COLOUR], second)
    way.reset()
    np.testing.assert_array_equal(way(room[0])[Role.COLOUR], first)


def test_a_history_can_be_taken_up(device: Device, room: list[Frame]) -> None:
    ways = [SceneShading(model=str(ROOM / "temporal.onnx")) for _ in range(2)]
    one, other = (Pipeline([way], device, exposure=1.0) for way in ways)
    one(room[0])
    kept = ways[0].history()
    wanted = one(room[1])[Role.COLOUR]
    other(room[2])
    ways[1].recall({name: np.array(values) for name, values in kept.items()})
    np.testing.assert_array_equal(other(room[1])[Role.COLOUR], wanted)


def test_shading_needs_the_camera_and_its_own_kind_of_model(device: Device,
                                                            room: list[Frame]) -> None:
    blind = Frame(dict(room[0].planes))
    with pytest.raises(FrameError, match="no camera in its file, which pass 'scene_shading' needs"):
        Pipeline([SceneShading(model=str(ROOM / "shading.onnx"))], device, exposure=1.0)(blind)
    with pytest.raises(ModelError, match="no network for pass 'scene_shading': train one by"):
        SceneShading(model=str(ROOM.parents[1] / "models/tonemap.local.onnx"))
    with pytest.raises(PassOptionError, match="finds no model 'missing.onnx'"):
        SceneShading(model="missing.onnx")
    with pytest.raises(ModelError, match="depth, camera, where pass 'irradiance' has points of 3"):
        Irradiance(model=str(ROOM / "shading.onnx"))
    assert SceneShading().skip(postfx.FrameSpec(8, 8, (Role.COLOUR,))) == "no model is given"


def test_irradiance_is_learnt_and_lights_surfaces(device: Device, tmp_path: Path) -> None:
    """Light of a known sky: exp(a + b . normal)."""
    random = np.random.default_rng(1)
    frames = []
    for number in range(1, 4):
        normal = random.standard_normal((*SIZE, 3)).astype(np.float32)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        albedo = random.uniform(0.1, 0.9, (*SIZE, 3)).astype(np.float32)
        light = np.exp(0.5 + normal @ np.float32([[0.2, 0, 0], [0.9, 1.0, 1.2], [0, 0, 0.3]]))
        normal[0] = 0  # misses
        colour = np.where(normal.any(-1, keepdims=True), albedo * light / np.float32(np.pi),
                          7.0).astype(np.float32)
        frames.append(Frame({Role.COLOUR: colour, Role.NORMAL: normal, Role.DIFFUSE_ALBEDO: albedo},
                            number=number))
    network, parameters = irradiance.train(frames[:2], (16, 16), 300)
    assert irradiance.error(network, parameters, frames[2:]) < 1e-3
    network.save_onnx(tmp_path / "sky.onnx", parameters)
    given = Frame(dict(frames[2].planes) | {Role.COLOUR: np.full((*SIZE, 3), 7.0, np.float32)})
    lit = Pipeline([Irradiance(model=str(tmp_path / "sky.onnx"))], device,
                   exposure=1.0)(given)[Role.COLOUR]
    assert (lit[0] == 7).all()
    np.testing.assert_allclose(lit[1:], frames[2][Role.COLOUR][1:], rtol=0.15)
    assert np.abs(lit[1:] / frames[2][Role.COLOUR][1:] - 1).mean() < 0.03


def lit_room(frame: Frame) -> Frame:
    """The frame by light of a known form: it grows with the place in the room, and with the
    normal."""
    place = places_of(camera_of(frame), frame[Role.DEPTH])
    shines = frame[Role.DEPTH] < 1e9
    light = np.where(shines,
                     1 + 0.2 * np.tanh(place) + 0.5 * np.maximum(frame[Role.NORMAL][..., 1:2], 0),
                     1.0)
    colour = light * reflectance_of(frame[Role.DIFFUSE_ALBEDO], frame[Role.SPECULAR_ALBEDO])
    return Frame({Role.COLOUR: colour.astype(np.float32)}, number=frame.number)


def test_places_are_those_of_the_projection(room: list[Frame]) -> None:
    """Mitsuba's cameras look along +z, with x to the left."""
    for frame in room:
        height, width = frame[Role.DEPTH].shape[:2]
        axes = {"right": "-x", "forward": "+z"}
        clip = frame.world_to_camera @ integrate.perspective(frame.fov_x, width, height, **axes)
        wanted = integrate.positions_from_depth(frame[Role.DEPTH], clip, frame.jitter)
        hit = frame[Role.DEPTH][..., 0] < 1e9
        np.testing.assert_allclose(places_of(camera_of(frame), frame[Role.DEPTH])[hit], wanted[hit],
                                   atol=1e-3)


def test_a_network_of_points_learns_light_and_shades(device: Device, room: list[Frame],
                                                     tmp_path: Path) -> None:
    """A frame that it has not seen, in which lamps keep their colour."""
    model = tmp_path / "room.onnx"
    lit = [lit_room(frame) for frame in room]
    train_scene.train_points(room[:2], lit[:2], (16, 16), 400, model)
    shaded = Pipeline([SceneShading(model=str(model))], device, exposure=1.0)(room[2])[Role.COLOUR]
    truth, emits = lit[2][Role.COLOUR], room[2][Role.DIFFUSE_ALBEDO] + room[2][Role.SPECULAR_ALBEDO]
    emits = emits.max(-1) < 0.005
    assert emits.any() and train_scene.psnr(shaded[~emits], truth[~emits]) > 30
    np.testing.assert_array_equal(shaded[emits], room[2][Role.COLOUR][emits])


def test_a_network_of_points_needs_its_card(tmp_path: Path, room: list[Frame]) -> None:
    network = Network(POINT, (4,), 3, "gelu", bands=4, encoded=3)
    network.save_onnx(tmp_path / "room.onnx", network.initial(1))
    with pytest.raises(ModelError,
                       match="no card with the scene's box beside it: keep the JSON file"):
        SceneShading(model=str(tmp_path / "room.onnx"))
    with pytest.raises(FrameError, match="no multiple of its frame's"):
        train_scene.light_at(Frame({Role.COLOUR: np.zeros((7, 9, 3), np.float32)}), room[0])
    with pytest.raises(FrameError, match="has no normal.*: render these planes, too"):
        train_scene.box_of([Frame({Role.COLOUR: room[0][Role.COLOUR],
                                   Role.DEPTH: room[0][Role.DEPTH]})])


def test_networks_of_points_are_for_one_pass(tmp_path: Path) -> None:
    for inputs, kind, message in ((POINT, Irradiance, "points of 9 numbers, where pass"),
                                  (3, SceneShading, "points of 3 numbers, which is no network")):
        network, model = Network(inputs, (4,), 3, "gelu"), tmp_path / f"{inputs}.onnx"
        network.save_onnx(model, network.initial(1))
        with pytest.raises(ModelError, match=message):
            kind(model=str(model))


def test_networks_are_trained_by_the_words_of_the_pages(postfx, tmp_path: Path) -> None:
    """On frames with planes, and the light of their references; each then runs as a pass."""
    noisy, reference = str(ROOM / "noisy.000[1-2].exr"), str(ROOM / "reference.####.exr")
    for kind, pass_name in (("points", "scene_shading"), ("irradiance", "irradiance")):
        model = tmp_path / f"{kind}.onnx"
        train_scene.main([kind, noisy, reference, str(model), "--steps", "2", "--hidden", "8"])
        done = postfx("run", str(ROOM / "noisy.####.exr"), "-o", kind, "--frames", "1", "--preroll",
                      "0", "--run-up", "0", "--pass", f"{pass_name},model={model}")
        assert done.code == 0 and f"ran      {pass_name}" in done.out + done.err


@pytest.mark.parametrize(("frames", "reference", "model", "message"), [
    ("missing.####.exr", ROOM / "reference.####.exr", "a.onnx", "no such file: check the folder"),
    (ROOM / "noisy.####.exr", "missing.####.exr", "a.onnx", "no such file: check the folder"),
    (ROOM / "reference.####.exr", ROOM / "reference.####.exr", "a.onnx",
     "has no normal, diffuse_albedo: render these planes"),
    (ROOM / "noisy.####.exr", ROOM / "reference.####.exr", "a.pt", "give a file of the kind .onnx"),
    (ROOM / "noisy.####.exr", ROOM / "reference.####.exr", "gone/a.onnx", "in a folder that is"),
])
def test_the_trainer_says_in_a_line_what_it_lacks(
    frames: Path, reference: Path, model: str, message: str, tmp_path: Path,
    capsys: pytest.CaptureFixture,
) -> None:
    with pytest.raises(SystemExit) as end:
        train_scene.main(["irradiance", str(frames), str(reference), str(tmp_path / model)])
    assert end.value.code == 2 and message in capsys.readouterr().err.splitlines()[-1]


def test_passes_stand_on_the_command_line(postfx) -> None:
    """By themselves before the denoiser, whose result has no planes of the render; elsewhere the
    reason says so."""
    frames = str(ROOM / "noisy.####.exr")
    alone = "--frames", "1", "--preroll", "0", "--run-up", "0"
    done = postfx("run", frames, "-o", "before", *alone, "--pass",
                  "occlusion,strength=0.5")
    assert done.code == 0 and "occlusion: network for 1 frame" in done.out + done.err
    done = postfx("run", frames, "-o", "after", *alone, "--pass", "occlusion,after=denoise_upscale")
    assert ("no plane depth here: render it, and let the pass run before=denoise_upscale"
            in done.out + done.err)
