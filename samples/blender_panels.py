"""Blender's panels with what postfx needs, drawn from Blender's own panels and those of the
extension.

python samples/blender_panels.py FOLDER      needs `make blender`, and POSTFX_BPY_PYTHON

POSTFX_BPY_PYTHON names a Python that has the package bpy.

Writes blender_passes.png and blender_panel.png. bpy has no window to photograph. So each panel's
own `draw` tells its rows to a recorder, before and after **Set up passes**, and the rows are drawn
here. What the button changed gets a frame.
"""
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

PASSES = {
    "View Layer > Passes > Data": ("CYCLES_RENDER_PT_passes_data", 9),
    "View Layer > Passes > Light": ("CYCLES_RENDER_PT_passes_light", 6),
    "Render > Sampling > Render > Denoise": ("CYCLES_RENDER_PT_sampling_render_denoise", 1),
    "Render > Sampling > Advanced": ("CYCLES_RENDER_PT_sampling_advanced", 2),
    "Render > Motion Blur": ("CYCLES_RENDER_PT_motion_blur", 1),
    "Output > Output": ("RENDER_PT_output", 6),
}
"""Title -> a panel of Blender, and how many of its rows the picture has, with the check box beside
the title."""
PANEL = {"Render > postfx": ("RENDER_PT_postfx", 99)}
TITLE = "beside the title"
"""The heading of a check box there."""


class Layout:
    """Stands in for Blender's layout, and writes down what a panel puts into it.

    A row is [heading, kind, label, value]; the kind is check, icon, value, button or text.
    """

    def __init__(self, rows, heading="", side_by_side=False):
        self.rows, self._heading, self._side_by_side = rows, heading, side_by_side
        self._line = None

    def _add(self, kind, label, value):
        if self._side_by_side and self._line is not None:
            self._line.append([self._heading, kind, label, value])
        else:
            self._line = [[self._heading, kind, label, value]]
            self.rows.append(self._line)
        self._heading = ""

    def _part(self, heading="", **_):
        return Layout(self.rows, heading or self._heading)

    column = split = box = _part

    def row(self, heading="", **_):
        part = Layout(self.rows, heading or self._heading, side_by_side=True)
        self._heading = ""
        return part

    def prop(self, data, name, text=None, icon="", **_):
        rule, value = data.bl_rna.properties[name], getattr(data, name)
        label = rule.name if text is None else text
        if rule.type == "BOOLEAN":
            self._add("icon" if icon else "check", label, value)
            return
        if rule.type == "ENUM":
            made = value.replace("_", " ").title()  # of an item that Blender makes while it draws
            value = next((item.name for item in rule.enum_items if item.identifier == value), made)
        self._add("value", label, f"{value:.3f}" if isinstance(value, float) else str(value))

    def operator(self, name, text="", **_):
        import bpy

        family, verb = name.split(".")
        self._add("button", text or getattr(getattr(bpy.ops, family), verb).get_rna_type().name, "")
        return type("Properties", (), {})()

    def label(self, text="", **_):
        self._add("text", text, "")

    def template_image_settings(self, settings, **_):
        for name in ("media_type", "file_format", "color_depth"):
            if name in settings.bl_rna.properties:
                self.prop(settings, name)

    def separator(self, **_):
        pass


def record(panels):
    """Title -> rows of each panel, as Blender would draw it now. Runs in bpy."""
    import bpy

    found = {}
    for title, (name, most) in panels.items():
        rows, kind = [], getattr(bpy.types, name)
        panel = type("Panel", (), {"layout": Layout(rows)})()
        if hasattr(kind, "draw_header"):
            kind.draw_header(panel, bpy.context)
            rows[0][0][0] = TITLE
        kind.draw(panel, bpy.context)
        found[title] = rows[:most]
    return found


def record_all(extension, block=None):
    """The panels before and after the set-up, and after a file of Python instead. Runs in bpy."""
    import bpy

    found = {}
    if block:
        begin_scene()
        exec(Path(block).read_text(), {})
        found["block"] = record(PASSES)
        bpy.ops.wm.read_factory_settings()
    bpy.ops.extensions.package_install_files(filepath=extension, repo="user_default",
                                             enable_on_install=True)
    begin_scene()
    found["before"] = record(PASSES)
    bpy.ops.postfx.set_up()
    return found | {"after": record(PASSES), "panel": record(PANEL)}


def begin_scene():
    import bpy

    render = bpy.context.scene.render
    render.engine, render.filepath = "CYCLES", "//render/shot_"


def in_blender(extension, *block):
    """What `record_all` finds, by the Python that POSTFX_BPY_PYTHON names."""
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"BLENDER_USER_RESOURCES": folder}
        environment.pop("PYTHONPATH", None)
        done = subprocess.run([os.environ["POSTFX_BPY_PYTHON"], __file__, "--record",
                               *map(str, (extension, *block))],
                              text=True, env=environment, capture_output=True)
    if done.returncode:
        raise SystemExit(done.stderr)
    return json.loads(done.stdout.splitlines()[-1])


WIDTH, LINE, EDGE = 430, 26, 10  # pixels of a panel, of a row, around both
SPLIT = 170  # where labels end and fields begin
PAPER, BACK, FIELD, BUTTON = (48, 48, 48), (61, 61, 61), (84, 84, 84), (101, 101, 101)
INK, QUIET, BLUE, FRAME = (230, 230, 230), (160, 160, 160), (71, 114, 179), (255, 176, 59)


def draw_panel(canvas, left, top, title, rows, changed):
    """One panel; returns the y below it."""
    rows = rows if rows[0][0][0] == TITLE else [[[TITLE, "none", "", ""]], *rows]
    height = LINE * len(rows) + EDGE
    canvas.box(left, top, left + WIDTH, top + height, BACK)
    for k, line in enumerate(rows):
        y = top + LINE * k + 4
        if changed and line[0][1] != "none" and line not in changed[title]:
            draw_frame(canvas, left + 4, y, left + WIDTH - 4, y + LINE - 2)
        if line[0][0] == TITLE:
            has_check = line[0][1] == "check"
            if has_check:
                draw_check(canvas, left + EDGE, y + 5, line[0][3])
            canvas.text(left + EDGE + 24 * has_check, y + LINE / 2 - 1, title, INK, 15)
        else:
            draw_line(canvas, left, y, line)
    return top + height + EDGE


def draw_frame(canvas, x0, y0, x1, y1):
    for box in ((x0, y0, x1, y0 + 2), (x0, y1 - 2, x1, y1), (x0, y0, x0 + 2, y1),
                (x1 - 2, y0, x1, y1)):
        canvas.box(*box, FRAME)


def draw_line(canvas, left, y, line):
    """Fields beside each other, in a panel's row."""
    middle, start = y + LINE / 2 - 1, left + SPLIT
    if line[0][1] == "button":
        start = left + EDGE
    if line[0][0]:
        canvas.text(start - EDGE, middle, line[0][0], QUIET, 14, "right")
    room = (left + WIDTH - EDGE - start) / sum(kind != "icon" for _, kind, _, _ in line)
    for _, kind, label, value in line:
        if kind == "check":
            draw_check(canvas, start, y + 5, value)
            canvas.text(start + 24, middle, label, INK, 14)
            start += 24 if not label else room
        elif kind == "icon":
            draw_clock(canvas, start - 26, y + 2, value)
        elif kind == "text":
            canvas.text(left + EDGE, middle, label, INK, 14)
        else:
            wide = left + WIDTH - EDGE if not label else start + room
            canvas.box(start, y + 2, wide - 4, y + LINE - 4, BUTTON if kind == "button" else FIELD)
            if kind == "button":
                canvas.text((start + wide) / 2, middle, label, INK, 14, "center")
            else:
                canvas.text(start - EDGE, middle, label, QUIET, 14, "right")
                canvas.text(start + 8, middle, value, INK, 14)
            start += room


def draw_check(canvas, x, y, on):
    canvas.box(x, y, x + 15, y + 15, BLUE if on else FIELD)
    if on:
        import numpy as np

        canvas.line(np.array([x + 3, x + 6, x + 12]), np.array([y + 8, y + 11, y + 4]), INK, 2)


def draw_clock(canvas, x, y, on):
    """The button of Animated Seed, at the right end of its row."""
    import numpy as np

    canvas.box(x, y, x + 22, y + 20, BLUE if on else FIELD)
    turn = np.linspace(0, 2 * np.pi, 25)
    canvas.line(x + 11 + 6 * np.cos(turn), y + 10 + 6 * np.sin(turn), INK, 1.5)
    canvas.line(np.array([x + 11, x + 11, x + 15]), np.array([y + 6, y + 10, y + 10]), INK, 1.5)


def draw(path, columns, changed):
    """A picture of panels in columns."""
    from postfx.canvas import Canvas

    heights = [sum(LINE * (len(rows) + (rows[0][0][0] != TITLE)) + 2 * EDGE
                   for rows in column.values())
               for column in columns]
    canvas = Canvas(len(columns) * (WIDTH + EDGE) + EDGE, max(heights) + EDGE, PAPER)
    for k, column in enumerate(columns):
        top = EDGE
        for title, rows in column.items():
            top = draw_panel(canvas, EDGE + k * (WIDTH + EDGE), top, title, rows, changed)
    canvas.save(path)


def main(folder):
    root = Path(__file__).resolve().parent.parent
    found = in_blender(root / "dist/postfx-blender.zip")
    after = found["after"]
    left = {title: after[title] for title in list(after)[:2]}
    right = {title: after[title] for title in list(after)[2:]}
    draw(folder / "blender_passes.png", [left, right], found["before"])
    draw(folder / "blender_panel.png", [found["panel"]], None)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--record"]:
        print("\n" + json.dumps(record_all(*sys.argv[2:])))
    elif len(sys.argv) == 2:
        main(Path(sys.argv[1]))
    else:
        raise SystemExit(__doc__)
