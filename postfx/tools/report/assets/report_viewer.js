// Two pictures of a frame, one left and one right of a line that the pointer or the keys move.
class Viewer {
  constructor() {
    for (const id of ["picture", "wipe", "ev", "left", "right", "zoom", "pixel"]) this[id] = document.getElementById(id);
    this.sides = { left: document.createElement("canvas"), right: document.createElement("canvas") };
    this.codes = new Map();  // packed picture -> its codes
    this.drawn = {};  // side -> what its canvas shows
    this.chosen = 0;
    for (const control of [this.wipe, this.ev]) control.addEventListener("input", () => this.draw());
    for (const control of [this.left, this.right, this.zoom]) control.addEventListener("change", () => this.draw());
    document.getElementById("ev-reset").addEventListener("click", () => { this.ev.value = 0; this.draw(); });
    this.wipe.addEventListener("pointermove", event => this.read(event));
    this.drawChoices();
    const widest = Math.max(...data.frames.flatMap(({ pictures }) => Object.values(pictures).map(({ width }) => width)));
    this.zoom.value = 2 * widest <= document.getElementById("port").clientWidth ? 2 : 1;
    this.show(data.frames.length - 1);
  }

  get frame() { return data.frames[this.chosen]; }

  drawChoices() {
    const place = document.getElementById("choices");
    for (const [index, frame] of data.frames.entries()) {
      const text = frame.why ? `${frame.number}, ${frame.why}` : String(frame.number);
      element("button", place, text).addEventListener("click", () => this.show(index));
    }
  }

  show(index) {
    this.chosen = index;
    this.codes.clear();
    const buttons = document.querySelectorAll("#choices button");
    for (const [place, button] of buttons.entries()) button.setAttribute("aria-pressed", place === index);
    const names = [...Object.keys(this.frame.pictures), ...Object.keys(this.frame.maps)];
    for (const [side, otherwise] of [["left", names[0]], ["right", names[Math.min(1, names.length - 1)]]]) {
      const before = this[side].value;
      this[side].replaceChildren(...names.map(name => new Option(name)));
      this[side].value = names.includes(before) ? before : otherwise;
    }
    document.getElementById("frames").classList.toggle("single", names.length === 1);
    this.describe();
    return this.draw();
  }

  describe() {
    const { size, exposure_ev, pictures, number } = this.frame, shown = Object.values(pictures)[0];
    const reduced = shown.width < size[0] ? `, reduced to ${shown.width}x${shown.height} (at most ${data.longest} pixels)` : "";
    const figures = Object.entries(data.readings[number]).filter(([key]) => /^(psnr|flip) /.test(key));
    const text = figures.map(([key, value]) => key.startsWith("psnr")
      ? `PSNR ${key.slice(5)} ${value.toPrecision(4)} dB` : `${key.replace("flip after", "FLIP")} ${value.toPrecision(4)}`).join(", ");
    document.getElementById("frame-note").textContent = `Frame ${number}, ${size[0]}x${size[1]}${reduced}. `
      + (data.display ? "Light of the display that the output is for; the slider exposes that."
        : `Scene-linear light, exposed by ${exposure_ev.toFixed(2)} EV, shown as x / (1 + x).`) + (text ? ` ${text}.` : "");
  }

  // Only what changed is painted anew; a later call overtakes an earlier one.
  async draw() {
    const turn = this.turn = (this.turn || 0) + 1, ev = Number(this.ev.value);
    for (const side of ["left", "right"]) await this.paintSide(side, ev);
    if (turn !== this.turn) return;
    document.getElementById("ev-text").textContent = `${ev > 0 ? "+" : ""}${ev.toFixed(1)} EV`;
    this.compose();
    for (const side of ["left", "right"]) document.getElementById(`${side}-name`).textContent = this[side].value;
  }

  async paintSide(side, ev) {
    const frame = this.frame, name = this[side].value, wanted = `${frame.number} ${name} ${name in frame.maps ? "" : ev}`;
    if (this.drawn[side] === wanted) return;
    if (name in frame.maps) await this.paintMap(this.sides[side], frame.maps[name]);
    else paint(this.sides[side], await this.codesOf(frame.pictures[name]), frame.pictures[name], ev, data.display);
    this.drawn[side] = wanted;
  }

  async codesOf(picture) {
    if (!this.codes.has(picture)) this.codes.set(picture, await unpack(picture));
    return this.codes.get(picture);
  }

  async paintMap(canvas, source) {
    const image = new Image();
    image.src = source;
    await image.decode();
    canvas.width = image.naturalWidth;
    canvas.height = image.naturalHeight;
    canvas.getContext("2d").drawImage(image, 0, 0);
  }

  compose() {
    const { left, right } = this.sides, canvas = this.picture, zoom = Number(this.zoom.value);
    const edge = this.left.value === this.right.value ? 0 : Math.round(left.width * this.wipe.value / 100);
    canvas.width = left.width;
    canvas.height = left.height;
    canvas.style.width = `${left.width * zoom}px`;
    const context = canvas.getContext("2d");
    context.drawImage(right, 0, 0);
    if (edge) context.drawImage(left, 0, 0, edge, left.height, 0, 0, edge, left.height);
    if (edge && edge < left.width) { context.fillStyle = "#ffffffc0"; context.fillRect(edge - 0.5 / zoom, 0, 1 / zoom, left.height); }
    canvas.dataset.frame = this.frame.number;
    canvas.dataset.edge = edge;
  }

  // The light below the pointer, in the units of the files.
  read(event) {
    const box = this.picture.getBoundingClientRect(), { width, height } = this.picture;
    const x = Math.floor((event.clientX - box.left) / box.width * width);
    const y = Math.floor((event.clientY - box.top) / box.height * height);
    const values = Object.entries(this.frame.pictures).filter(([, picture]) => this.codes.has(picture)).map(([name, picture]) => {
      const codes = this.codes.get(picture).subarray(3 * (y * width + x)), gain = data.display ? 1 : 2 ** -this.frame.exposure_ev;
      return `${name} ${[0, 1, 2].map(i => (lightOf(codes[i], picture) * gain).toPrecision(3)).join(" ")}`;
    });
    if (x >= 0 && y >= 0 && x < width && y < height) this.pixel.textContent = `(${x}, ${y})  ${values.join("   ")}`;
  }
}
