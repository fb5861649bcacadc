"""The page of a capture: what it holds, that it needs nothing beside it, and that its script draws
it."""

import json
import re
import sys

import numpy as np
import pytest

from postfx.errors import ReadError, WriteError
from postfx.runtime import ArgumentTable, Device
from postfx.runtime.capture import MISSING
from postfx.tools.report.capture_data import as_dict, read
from postfx.tools.report.page import write_capture
from tests import toys

SVG = "http://www.w3.org/2000/svg"


def page_of(capture, folder):
    return write_capture(capture, folder, "toy").read_text(encoding="utf-8")


def embedded(text):
    (data,) = re.findall(r'<script type="application/json" id="data">(.*?)</script>', text,
                         re.DOTALL)
    return json.loads(data)


def test_json_is_machine_readable(make_capture, tmp_path):
    path = write_capture(make_capture(), tmp_path / "new" / "out", "toy")
    assert path == tmp_path / "new" / "out" / "capture.html"
    data, folder = read(tmp_path / "new" / "out")
    assert (data, folder) == read(path.with_name("capture.json"))
    assert [command["label"] for command in data["commands"]] == ["toy/add", "toy/double"]
    assert data["buffers"][0]["records"] == [
        {"dispatch": 0},
        {
            "barrier": "consumer", "encoder": data["commands"][1]["encoder"],
            "after": ["compute"], "before": ["machine-learning"],
        },
        {"dispatch": 1},
    ]  # fmt: skip
    assert data["edges"] == [
        {"from": None, "to": 0, "tensor": "a"},
        {"from": None, "to": 0, "tensor": "b"},
        {"from": 0, "to": 1, "tensor": "total"},
    ]
    (written,) = data["commands"][1]["writes"]
    assert (written["statistics"]["mean"] == 6.0 and written["shape"] == [1, 4, 5]
            and written["values"] == [6.0] * 20)


def test_what_is_not_finite_is_text_in_json(make_capture):
    data = as_dict(make_capture(a=float("nan"), b=1.0))
    (written,) = data["commands"][1]["writes"]
    assert written["values"] == ["nan"] * 20 and written["statistics"]["minimum"] is None
    json.dumps(data, allow_nan=False)


def test_the_page_needs_nothing_beside_it(make_capture, tmp_path):
    text = page_of(make_capture(), tmp_path)
    assert set(re.findall(r"https?://[^\s\"'<>]+", text)) == {SVG}
    assert not re.search(r"<(link|iframe|img|object|embed)\b|<script[^>]+src|@import|url\(", text)
    assert "default-src 'none'" in text
    assert "{{" not in text.split('id="data"')[0]


def test_pictures_and_nodes_are_in_the_page(make_capture, tmp_path):
    data = embedded(page_of(make_capture(), tmp_path))
    (total,) = data["commands"][0]["writes"]
    ((picture,),) = [data["pictures"][total["pictures"]]]
    assert picture["src"].startswith("data:image/png;base64,iVBORw0KGgo")
    assert data["commands"][1]["reads"][0]["pictures"] is None
    (network,) = data["networks"]
    assert (network["name"], network["note"], network["commands"]) == ("double", None, [1])
    assert network["values"]["x"] == {"dtype": "float32", "shape": [1, 4, 5]}
    (node,) = network["nodes"]
    assert (node["op"], node["inputs"], node["outputs"]) == ("Add", ["x", "x"], ["y"])


def test_without_onnx_the_page_says_so(make_capture, monkeypatch, tmp_path):
    capture = make_capture()
    monkeypatch.setitem(sys.modules, "onnx", None)
    (network,) = embedded(page_of(capture, tmp_path))["networks"]
    assert network["note"] == MISSING and network["nodes"] == []


def test_all_has_a_picture_for_each_channel_and_each_input_once(tmp_path):
    device = Device("cpu", threads=1)
    state = device.compute_state(toys.ADD)
    a = device.wrap("a", np.ones((8, 9, 5), np.float32))
    total = device.heap.tensor("total", (8, 9, 5))
    commands = device.command_buffer("frame")
    with commands.compute_encoder("add") as encoder:
        encoder.dispatch(state, ArgumentTable(state, {"a": a, "b": a, "total": total}))
    with device.capture("all", tmp_path) as capture:
        commands.commit()
        commands.wait(10)
    data = embedded(page_of(capture, tmp_path))
    (command,) = data["commands"]
    labels = [picture["label"] for picture in data["pictures"][command["writes"][0]["pictures"]]]
    assert labels == ["channels 0 to 2 as colour", *(f"channel {number}" for number in range(5))]
    assert ([tensor["pictures"] for tensor in command["reads"]] == [0, 0]
            and len(data["pictures"]) == 2)


def test_a_new_capture_takes_the_place_of_an_older_one(make_capture, tmp_path):
    """Once it is whole; another program's files stay, and what a killed process left goes."""
    folder = tmp_path / "look"

    def files():
        return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}

    def kept():
        commands = json.loads((folder / "capture.json").read_text())["commands"]
        return {entry["file"] for command in commands
                for entry in command["reads"] + command["writes"] if entry.get("file")}

    own = {"capture.html", "capture.json"}
    write_capture(make_capture(tensors="all", folder=folder), folder, "first")
    first = kept()
    assert first and files() == own | first
    for name in ("tensors/0000.0.y.npy", "tensors/999999999-0123abcd/0000.0.y.npy",
                 "tensors/notes.txt"):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text("left")
    capture = make_capture(tensors="all", folder=folder)
    assert first < files()
    write_capture(capture, folder, "second")
    assert not first & kept() and files() == own | kept() | {"tensors/notes.txt"}


def test_folders_that_cannot_be_written(make_capture, tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(WriteError, match="cannot be written: "):
        write_capture(make_capture(), tmp_path / "file" / "out", "toy")


def test_other_files_are_no_captures(tmp_path):
    (tmp_path / "capture.json").write_text("{}")
    with pytest.raises(ReadError, match="is not a capture by this version"):
        read(tmp_path)
    with pytest.raises(ReadError, match="cannot be read"):
        read(tmp_path / "missing.json")


def test_the_script_draws_commands_graph_and_details(make_capture, tmp_path, rendered):
    found = rendered(write_capture(make_capture(), tmp_path / "out", "toy"),
                     "networks.get(1).show(1); choose(1);")
    rows = re.search(r'<table id="commands">(.*?)</table>', found, re.DOTALL)[1]
    assert ([label for label in ("toy/add", "toy/double") if f"<td>{label}</td>" in rows]
            == ["toy/add", "toy/double"])
    graph = re.search(r'<div id="graph">(.*?)</svg>', found, re.DOTALL)[1]
    assert len(re.findall(r'<g class="box ', graph)) == 2
    assert re.findall(r'<g class="edge[^"]*" data-from="(\d+)" data-to="(\d+)"',
                      graph) == [("0", "1")]
    assert re.findall(r'data-form="(\w+)"', graph) == ["consumer"]
    details = re.search(r'<aside id="details">(.*?)</aside>', found, re.DOTALL)[1]
    assert ("6 to 6, mean 6" in details and "written by command "
            "0" in details and "data:image/png" in details)
    assert ">its graph</button>" in details
    assert ">Add</span>" in re.search(r'<section id="networks">(.*?)</section>', found,
                                      re.DOTALL)[1]


def test_a_click_shows_a_command_and_what_is_not_finite(make_capture, tmp_path, rendered):
    path = write_capture(make_capture(a=float("inf"), b=1.0), tmp_path / "out", "toy")
    click = ("""document.querySelector('g[data-command="0"] rect')"""
             """.dispatchEvent(new MouseEvent("click"));""")
    found = rendered(path, "choose(1); " + click)
    details = re.search(r'<aside id="details">(.*?)</aside>', found, re.DOTALL)[1]
    assert "kernel 'add'" in details and '<p class="bad">0 NaN, 20 infinite</p>' in details
    assert found.count('<td class="bad">20 infinite</td>') == 2


def test_names_cannot_become_elements(make_capture, tmp_path, rendered):
    name = '</script><img src="x">{{data}}<b>&'
    path = write_capture(make_capture(name=name), tmp_path / "out", "<i>toy</i>")
    found = rendered(path, "choose(0);")
    assert "<h3>&lt;/script&gt;&lt;img src=\"x\"&gt;{{data}}&lt;b&gt;&amp;</h3>" in found
    assert '<img src="x"' not in found and "<i>" not in found
