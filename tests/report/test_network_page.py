"""The page of a network: its graph, what happened in it, and that it stays quick."""

import re

import numpy as np
import pytest

from postfx.runtime import ArgumentTable, Device
from postfx.tools.report.page import write_capture
from tests.deep import capture_deep, make_deep, make_long


@pytest.fixture
def deep(tmp_path):
    return make_deep(tmp_path / "models")


@pytest.fixture
def page_of(deep, tmp_path):
    def make(**options):
        return write_capture(capture_deep(deep, **options)[0], tmp_path / "out", "toy")

    return make


OPEN = "networks.get(0).show(0);"


def drawn(found):
    """Rows of the network as (node or block, text)."""
    rows = re.findall(r'<div class="cells ([^"]*)"(?: '
                      r'data-(?:node|block)="(\d+)")?[^>]*>(.*?)</div>', found)
    return [(kind, number, re.sub(r"<[^>]+>", " ", text))
            for kind, number, text in rows if kind != "head"]


def lines(found):
    return re.findall(r'<g class="line [^"]*" data-value="([^"]*)"><path d="([^"]*)"', found)


def details(found):
    return re.search(r'<aside id="details">(.*?)</aside>', found, re.DOTALL)[1]


def test_rows_in_order_with_attributes_shapes_and_weights(page_of, rendered):
    found = rendered(page_of(), OPEN)
    rows = drawn(found)
    assert ([(kind.split()[0], number) for kind, number, _ in rows] == [
        ("input", ""), ("block", "0"), ("node", "1"), ("node", "2"), ("block", "1"), ("node", "3"),
        ("node", "4"), ("node", "5"), ("output", ""),
    ])  # fmt: skip
    conv = rows[2][2]
    assert all(text in conv
               for text in ("Conv", "stem", "kernel 3×3, pad 1", "1×4×4×5 float32", "144 B"))
    assert "deep, height 4, width 5: 6 nodes, 73 parameters in 148 B" in found
    assert 'class="network"' in found and "Nodes one by one" not in found


def test_lines_lead_from_writer_to_readers(page_of, rendered):
    paths = dict(lines(rendered(page_of(), OPEN)))
    assert set(paths) == {"x", "conv", "relu", "above", "root", "y"}
    assert "H" not in paths["conv"]
    assert paths["relu"].count("M") == 3, "straight down to Sub, and through a lane to Add"


def test_blocks_close_and_open(page_of, rendered):
    closed = drawn(rendered(page_of(),
                            OPEN + "document.querySelector('[data-block=\"0\"]').click();"))
    assert [number for kind, number, _ in closed if kind.startswith("node")] == ["3", "4", "5"]
    (block,) = [text for kind, number, text in closed if number == "0"]
    assert "2 nodes" in block and "Conv Relu" in block and "1×4×4×5" in block
    every = "document.querySelectorAll('.tools button')[{}].click();"
    found = drawn(rendered(page_of(), OPEN + every.format(1)))
    assert [number for kind, number, _ in found if kind.startswith("node")] == ["5"]
    found = drawn(rendered(page_of(), OPEN + every.format(1) + every.format(0)))
    assert [number for kind, number, _ in found if kind.startswith("node")] == ["1", "2", "3", "4",
                                                                                "5"]


def test_constants_are_shown_on_request(page_of, rendered):
    found = drawn(rendered(page_of(),
                           OPEN + "document.querySelector('.tools input[type=checkbox]').click();"))
    nodes = [(kind, number) for kind, number, _ in found if kind.startswith("node")]
    assert nodes[0] == ("node constant", "0") and len(nodes) == 6


def test_search_finds_weights_and_attributes_and_opens_blocks(page_of, rendered):
    search = ("const s = document.querySelector('.tools input'); s.value = '%s'; "
              "s.dispatchEvent(new Event('input'));")
    close = "document.querySelectorAll('.tools button')[1].click();"
    found = rendered(page_of(), OPEN + close + search % "pads=1 STEM")
    assert "<h2 style=\"margin-top: 0px;\">1  Conv</h2>" in details(found) and "1 of 1" in found
    assert any("chosen" in kind and number == "1" for kind, number, _ in drawn(found))
    assert "nothing found" in rendered(page_of(), OPEN + search % "softmax")


def test_a_node_shows_all_about_it(page_of, rendered):
    text = details(rendered(page_of(network=True), OPEN + "networks.get(0).node(1);"))
    assert "<th>kernel_shape</th><td>3, 3</td>" in text and "<h3>stem.weight_half</h3>" in text
    assert "(4, 2, 3, 3) float16, 144 B" in text and "1 to 1, mean 1" in text
    assert "read by <button>2 Relu</button>" in text and "ms by itself" in text
    assert "8 to 18, mean " in text and "data:image/png" in text
    assert "input of the network" in text


def test_where_a_nan_begins_is_said_and_one_click_away(page_of, rendered):
    found = rendered(page_of(x=0.0, network=True),
                     OPEN + "document.querySelector('button.first').click();")
    assert "Begins to be not finite: node 4 Sqrt, all NaN" in found and "4  Sqrt" in details(found)
    found = rendered(page_of(x=float("nan"), network=True), OPEN)
    assert ("Input 'x' is not finite: all NaN" in found and "First node that is not finite: node 1 "
            "Conv" in found)
    assert "not finite:" not in rendered(page_of(network=True), OPEN)


def test_times_and_pictures_are_in_the_rows(page_of, rendered):
    found = rendered(page_of(network=True), OPEN)
    assert re.search(r'<span class="ms" style="--share: [\d.]+%;">\d+\.\d\d</span>', found)
    assert found.count('<span class="thumb"><img') >= 5
    assert re.search(r"one by one [\d.]+ ms; the command, fused and optimised, [\d.]+ ms; their "
                     r"results differ", found)


def test_arrow_keys_go_from_node_to_node(page_of, rendered):
    key = ("document.querySelector('.port').dispatchEvent(new KeyboardEvent('keydown', {key: "
           "'Arrow%s'}));")
    found = rendered(page_of(), OPEN + "networks.get(0).node(2);" + 2 * (key % "Down") + key % "Up")
    assert ">3  Sub</h2>" in details(found)


def test_a_network_that_ran_twice_shows_either_run(deep, tmp_path, rendered):
    device = Device("cpu", threads=1)
    state = device.pipeline_state(deep, "deep", {"height": 4, "width": 5})
    x, y = device.heap.tensor("picture", (1, 2, 4, 5)), device.heap.tensor("y", (1, 4, 4, 5))
    commands = device.command_buffer("frame")
    with device.capture(network=True) as capture:
        for content in (1.0, 0.0):
            x.fill(content)
            commands.begin()
            with commands.machine_learning_encoder("deep") as encoder:
                encoder.dispatch_network(state, ArgumentTable(state, {"x": x, "y": y}))
            commands.commit()
            commands.wait(10)
    path = write_capture(capture, tmp_path / "out", "toy")
    assert "Begins to be not finite" not in rendered(path, OPEN)
    choose = ("const c = document.querySelector('.tools select'); c.value = 1; c.dispatchEvent(new "
              "Event('change'));")
    assert "Begins to be not finite: node 4 Sqrt" in rendered(path, OPEN + choose)
    shown = ("networks.get(1).show(1); document.body.dataset.choice = "
             "document.querySelector('.tools select').value;")
    found = rendered(path, shown)
    assert "Begins to be not finite: node 4 Sqrt" in found and 'data-choice="1"' in found


def test_names_cannot_become_elements(tmp_path, rendered):
    from onnx import helper

    from postfx.runtime import Library
    from tests import toys

    name = '<img src="x">'
    node = helper.make_node("Add", ["x", "x"], ["y"], name)
    toys.save_model(tmp_path / "odd.onnx", [node], [toys.value("x", (3,))], [toys.value("y", (3,))])
    found = rendered(write_capture(captured(Library(tmp_path), "odd", 3), tmp_path / "out", "toy"),
                     "networks.get(0).node(0);")
    assert "&lt;img src=" in details(found) and '<img src="x"' not in found


def test_a_large_network_is_quick(tmp_path, rendered):
    """Ten thousand nodes: only what is in sight is in the page, and opening all takes no ten
    seconds, on a busy machine neither."""
    path = write_capture(captured(make_long(tmp_path / "models", 10_000), "long", 4),
                         tmp_path / "out", "toy")
    script = """const begin = performance.now(); networks.get(0).show(0);
    document.querySelectorAll('.tools button')[0].click(); networks.get(0).node(9000);
    document.body.dataset.took = performance.now() - begin;"""
    found = rendered(path, script)
    rows = drawn(found)
    assert (any(number == "9000" and "chosen" in kind for kind, number, _ in rows)
            and len(rows) < 200)
    assert float(re.search(r'data-took="([\d.]+)"', found)[1]) < 10_000
    assert path.stat().st_size < 5e6


def captured(library, name, size):
    device = Device("cpu", threads=1)
    state = device.pipeline_state(library, name)
    (x, y) = state.bindings
    tensors = {x.name: device.wrap("x", np.ones(size, np.float32)),
               y.name: device.heap.tensor("y", (size,))}
    commands = device.command_buffer("frame")
    with commands.machine_learning_encoder(name) as encoder:
        encoder.dispatch_network(state, ArgumentTable(state, tensors))
    with device.capture() as capture:
        commands.commit()
        commands.wait(30)
    return capture
