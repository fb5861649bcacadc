// Draws a network: a box for each node, lines for what they hand on. Only rows in sight are in the page, so that a
// network of ten thousand nodes scrolls as fast as one of ten.
const ROW = { height: 26, box: 20, lane: 9, before: 12, spare: 12 };
const OPENED = 150;  // larger networks come with their blocks closed
const FAMILIES = {
  heavy: "Conv ConvTranspose ConvInteger QLinearConv Gemm MatMul MatMulInteger QLinearMatMul LSTM GRU Attention",
  shaping: "Relu LeakyRelu PRelu Elu Selu Gelu Sigmoid HardSigmoid HardSwish Tanh Softmax Softplus Clip Exp Log Sqrt",
  types: "QuantizeLinear DequantizeLinear DynamicQuantizeLinear Cast CastLike",
  sampling: "MaxPool AveragePool GlobalAveragePool GlobalMaxPool Resize Upsample Pad DepthToSpace SpaceToDepth GridSample",
  arithmetic: "Add Sub Mul Div Pow Min Max Sum Mean Abs Neg Where ReduceMean ReduceSum ReduceMax LayerNormalization "
    + "BatchNormalization InstanceNormalization",
};
const FAMILY = new Map(Object.entries(FAMILIES).flatMap(([family, ops]) => ops.split(" ").map(op => [op, family])));

function sizes(value) {
  return value && value.shape ? `${value.shape.join("\u00d7") || "scalar"}` : "";
}

function short(value) {
  if (typeof value !== "number") return value === null ? "none" : value;
  const size = Math.abs(value);
  return size && (size < 1e-3 || size >= 1e5) ? value.toExponential(1) : String(Number(value.toPrecision(3)));
}

// Attributes that differ from the operator's usual ones, in few words.
function brief(attributes) {
  const usual = { dilations: /^(1,?)+$/, strides: /^(1,?)+$/, group: /^1$/, pads: /^(0,?)+$/, auto_pad: /NOTSET/,
    ceil_mode: /^0$/, storage_order: /^0$/, saturate: /^1$/, antialias: /^0$/, exclude_outside: /^0$/,
    cubic_coeff_a: /^-0.75$/, extrapolation_value: /^0$/, keep_aspect_ratio_policy: /stretch/ };
  const names = { kernel_shape: "kernel", mode: "mode", strides: "stride", pads: "pad", dilations: "dilation", group: "groups" };
  const order = [...Object.keys(names), ...Object.keys(attributes)];
  return Object.entries(attributes).filter(([key, value]) => !(usual[key] && usual[key].test(String(value))))
    .sort(([a], [b]) => order.indexOf(a) - order.indexOf(b))
    .map(([key, value]) => `${names[key] || key} ${alike(key, value)}`).join(", ");
}

function alike(key, value) {
  if (!Array.isArray(value)) return String(value);
  if (key !== "kernel_shape" && value.length && value.every(size => size === value[0])) return String(value[0]);
  return value.join(key === "kernel_shape" || key === "strides" ? "\u00d7" : ",");
}

// Which parts of the network the weights are from, as their names tell; else the first node's own name.
function titleOf(nodes) {
  const parts = nodes.flatMap(node => node.weights).map(name => name.split(".").slice(0, -1).join("."));
  return [...new Set(parts.filter(Boolean))].join(", ") || nodes[0].name || nodes[0].outputs[0];
}

function weightBytes(network, nodes) {
  const names = new Set(nodes.filter(n => !network.nodes[n].constant).flatMap(n => network.nodes[n].weights));
  return [...names].reduce((total, name) => total + network.weights[name].bytes, 0);
}

function wrong(value) {
  const found = value && value.statistics;
  if (!found) return "";
  const size = (value.shape || []).reduce((a, b) => a * b, 1), count = n => n === size ? "all" : n;
  return [found.nans && `${count(found.nans)} NaN`, found.infinities && `${count(found.infinities)} infinite`]
    .filter(Boolean).join(", ");
}

class NetworkView {
  constructor(network, place) {
    this.network = network;
    this.open = new Set(network.nodes.length > OPENED ? [] : network.blocks.keys());
    this.constants = false;
    this.chosen = null;
    this.choice = null;
    this.matches = [];
    this.block = new Map(network.blocks.flatMap((nodes, number) => nodes.map(node => [node, number])));
    this.box = element("div", place, undefined, "network");
    this.select(network.commands[0]);
    drawTools(this, this.box);
    this.verdict = element("p", this.box);
    this.port = element("div", this.box, undefined, "port");
    this.port.tabIndex = 0;
    this.head = element("div", this.port, undefined, "cells head");
    this.canvas = element("div", this.port, undefined, "canvas");
    this.port.addEventListener("scroll", () => this.draw());
    this.port.addEventListener("keydown", event => this.key(event));
    new ResizeObserver(() => this.draw()).observe(this.port);
    this.update();
  }

  // Show what happened in one of the commands that ran the network.
  select(command) {
    this.command = data.commands[command];
    if (this.choice) this.choice.value = command;
    const run = this.command.network;
    this.ran = new Map(run ? run.nodes.map(node => [node.index, node]) : []);
    this.values = new Map(Object.entries(this.network.values));
    if (run) for (const node of run.nodes) for (const value of node.outputs) this.values.set(value.name, value);
    this.network.inputs.forEach((name, order) => this.values.set(name, this.input(name, order)));
    this.slowest = Math.max(0, ...[...this.ran.values()].map(node => node.ms || 0));
    this.box.classList.toggle("ran", this.ran.size > 0);
  }

  // What the command read as an input of the network: with figures, where the capture has them.
  input(name, order) {
    const tensor = this.command.reads[order];
    if (!tensor || this.command.reads.length !== this.network.inputs.length) return this.network.values[name];
    const writers = data.edges.filter(e => e.to === this.command.index && e.tensor === tensor.name).map(e => e.from);
    return asWritten(tensor, writers);
  }

  // Work out rows and lines anew, after blocks were opened or closed.
  update() {
    this.rows = networkRows(this.network, this);
    this.lines = networkLines(this.network, this.rows);
    const lanes = this.lines.reduce((most, line) => Math.max(most, line.lane === null ? 0 : line.lane + 1), 0);
    this.gutter = ROW.before + lanes * ROW.lane;
    this.places = placesOf(this.rows);
    this.canvas.style.height = `${this.rows.length * ROW.height}px`;
    this.box.style.setProperty("--gutter", `${this.gutter}px`);
    drawVerdict(this);
    drawHead(this);
    this.draw();
  }

  draw() {
    const top = Math.max(0, this.port.scrollTop - this.head.offsetHeight);
    const first = Math.max(0, Math.floor(top / ROW.height) - ROW.spare);
    const last = Math.min(this.rows.length, Math.ceil((top + this.port.clientHeight) / ROW.height) + ROW.spare);
    this.canvas.replaceChildren(drawLines(this, first, last));
    for (let number = first; number < last; number++) drawRow(this, number);
  }

  toggle(block) {
    this.open.has(block) ? this.open.delete(block) : this.open.add(block);
    this.update();
  }

  // Open and close all; the chosen node stays in sight.
  openAll(open) {
    this.open = new Set(open ? this.network.blocks.keys() : []);
    this.update();
    if (this.chosen !== null) this.scrollTo(this.places.node.get(this.chosen));
  }

  choose(node) {
    this.chosen = node;
    if (this.network.nodes[node].constant) this.constants = true;
    this.open.add(this.block.get(node));
    this.update();
    this.scrollTo(this.places.node.get(node));
    drawNodeDetails(this, node);
  }

  scrollTo(row) {
    const y = row * ROW.height, port = this.port;
    if (y < port.scrollTop || y + 3 * ROW.height > port.scrollTop + port.clientHeight)
      port.scrollTop = Math.max(0, y - port.clientHeight / 3);
    this.draw();
  }

  key(event) {
    const step = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    if (!step) return;
    event.preventDefault();
    const nodes = this.rows.filter(row => row.kind === "node").map(row => row.node);
    const next = nodes[nodes.indexOf(this.chosen) + step];
    if (next !== undefined) this.choose(next);
  }
}
