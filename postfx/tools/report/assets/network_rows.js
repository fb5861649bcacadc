// The parts of a network's drawing: tools, head, rows and lines.
function drawTools(view, place) {
  const tools = element("div", place, undefined, "tools"), search = element("input", tools);
  Object.assign(search, { type: "search", placeholder: "search operator, name, value, weight, attribute" });
  const count = element("span", tools, "", "note");
  const show = (step, keep) => {
    const words = search.value.toLowerCase().split(/\s+/).filter(Boolean);
    view.matches = words.length ? found(view, words) : [];
    const at = view.matches.indexOf(view.chosen), length = view.matches.length;
    const next = keep && at >= 0 ? at : ((at < 0 ? (step < 0 ? 0 : -1) : at) + step + length) % length;
    count.textContent = words.length ? (length ? `${next + 1} of ${length}` : "nothing found") : "";
    length ? view.choose(view.matches[next]) : view.draw();
  };
  search.addEventListener("input", () => show(1, true));
  search.addEventListener("keydown", event => { if (event.key === "Enter") show(event.shiftKey ? -1 : 1, false); });
  element("button", tools, "open all").addEventListener("click", () => view.openAll(true));
  element("button", tools, "close all").addEventListener("click", () => view.openAll(false));
  const label = element("label", tools), box = element("input", label);
  box.type = "checkbox";
  label.append(" constants");
  label.title = "nodes that depend on no input, such as those that unpack weights";
  box.addEventListener("change", () => { view.constants = box.checked; view.update(); });
  if (view.network.commands.length > 1) drawChoice(view, tools);
}

function drawChoice(view, tools) {
  const choice = view.choice = element("select", tools);
  for (const number of view.network.commands)
    element("option", choice, `command ${number}: ${data.commands[number].label}`).value = number;
  choice.addEventListener("change", () => {
    view.select(Number(choice.value));
    view.update();
    if (view.chosen !== null) drawNodeDetails(view, view.chosen);
  });
}

// Nodes whose texts have all the words, in the order of drawing.
function found(view, words) {
  const { network } = view;
  return network.blocks.flat().filter(number => {
    const node = network.nodes[number];
    if (node.constant && !view.constants) return false;
    const text = [number, node.op, node.name, ...node.inputs, ...node.outputs, ...node.weights,
      ...Object.entries(node.attributes).map(([key, value]) => `${key}=${value}`)].join(" ").toLowerCase();
    return words.every(word => text.includes(word));
  });
}

// The first value that is not finite, or the node that failed, and what running node by node took.
function drawVerdict(view) {
  view.verdict.replaceChildren();
  const run = view.command.network;
  if (!run) return;
  const failed = run.nodes.find(node => node.error), input = view.network.inputs.find(name => wrong(view.values.get(name)));
  const first = run.nodes.find(node => node.outputs.some(wrong));
  const total = run.nodes.reduce((ms, node) => ms + (node.ms || 0), 0);
  element("span", view.verdict, `Nodes one by one ${total.toFixed(1)} ms; the command, fused and optimised, ${state(view.command)}`
    + (run.difference === null ? ". " : `; their results differ by at most ${short(run.difference)} (relative). `), "note");
  const named = node => `node ${node.index} ${node.op}`;
  if (input) element("span", view.verdict, `Input '${input}' is not finite: ${wrong(view.values.get(input))}. `, "bad");
  const marked = failed || first;
  if (!marked) return;
  const text = failed ? `${named(failed)} failed: ${failed.error}`
    : `${input ? "First node that is not finite" : "Begins to be not finite"}: ${named(first)}, ${wrong(first.outputs.find(wrong))}`;
  element("button", view.verdict, text, "bad first").addEventListener("click", () => view.choose(marked.index));
}

function drawHead(view) {
  view.head.replaceChildren();
  for (const name of ["operator", "part", "attributes", "output", "weights"]) element("span", view.head, name, name);
  if (view.ran.size) for (const name of ["ms", "range", ""]) element("span", view.head, name, name);
}

function drawRow(view, number) {
  const row = view.rows[number], line = element("div", view.canvas, undefined, `cells ${row.kind}`);
  line.style.top = `${number * ROW.height}px`;
  if (row.kind === "block") return drawBlock(view, row, line);
  if (row.kind === "node") return drawNode(view, row, line);
  element("span", element("span", line, undefined, "operator"), row.kind, "box edge");
  element("span", line, row.name, "part");
  element("span", line);
  drawValue(view, line, view.values.get(row.name), "", null);
}

function drawNode(view, row, line) {
  const node = view.network.nodes[row.node], ran = view.ran.get(row.node), bytes_ = weightBytes(view.network, [row.node]);
  line.dataset.node = row.node;
  line.classList.toggle("chosen", view.chosen === row.node);
  line.classList.toggle("match", view.matches.includes(row.node));
  line.classList.toggle("constant", node.constant);
  element("span", element("span", line, undefined, "operator"), node.op, `box ${FAMILY.get(node.op) || "moving"}`);
  element("span", line, titleOf([node]), "part").title = `${row.node} ${node.name}`;
  element("span", line, brief(node.attributes), "attributes").title = brief(node.attributes);
  drawValue(view, line, view.values.get(node.outputs[0]), bytes_ ? bytes(bytes_) : "", ran);
  line.addEventListener("click", () => { view.choose(row.node); view.port.focus({ preventScroll: true }); });
}

function drawBlock(view, row, line) {
  const { network } = view, nodes = row.nodes.map(number => network.nodes[number]).filter(node => !node.constant);
  const ran = row.nodes.map(number => view.ran.get(number)).filter(Boolean), size = weightBytes(network, row.nodes);
  line.dataset.block = row.block;
  line.classList.toggle("open", row.open);
  const operator = element("span", line, undefined, "operator"), ops = nodes.map(node => node.op).join(" ");
  element("button", operator, row.open ? "\u25be" : "\u25b8").setAttribute("aria-label", "open or close");
  element("span", operator, `${row.nodes.length} nodes`, row.open ? "" : "box many");
  element("span", line, titleOf(nodes), "part").title = titleOf(nodes);
  element("span", line, row.open ? "" : ops, "attributes").title = ops;
  line.addEventListener("click", () => view.toggle(row.block));
  const whole = { ms: ran.reduce((ms, node) => ms + (node.ms || 0), 0), outputs: ran.flatMap(node => node.outputs),
    error: ran.some(node => node.error) };
  const last = row.open ? null : view.values.get(nodes.at(-1).outputs[0]);
  drawValue(view, line, last, size ? bytes(size) : "", ran.length ? whole : null);
}

// The last cells of a row: an output's shape, the weights' size and, where the network was looked into, figures.
function drawValue(view, line, value, weights, ran) {
  element("span", line, value ? `${sizes(value)} ${value.dtype}` : "", "output").title = value ? sizes(value) : "";
  element("span", line, weights, "number");
  if (!view.ran.size) return;
  const time = element("span", line, ran && ran.ms !== null ? ran.ms.toFixed(2) : "", "ms");
  if (ran && view.slowest) time.style.setProperty("--share", `${Math.min(100, 100 * (ran.ms || 0) / view.slowest)}%`);
  const known = value && value.statistics;
  const bad = ran && ran.error ? "failed" : ran ? ran.outputs.map(wrong).find(Boolean) : wrong(value);
  const range = element("span", line, undefined, "range");
  if (bad) element("span", range, `${bad} `, "bad");
  if (known && known.minimum !== null) range.append(`${short(known.minimum)} \u2026 ${short(known.maximum)}`);
  const thumb = element("span", line, undefined, "thumb"), picture = value && data.pictures[value.pictures ?? -1];
  if (!picture) return;
  const { src, tiles = [1, 1], liveliest = 0 } = picture[0], [columns, rows] = tiles, image = element("img", thumb);
  Object.assign(image, { src, alt: "" });
  Object.assign(image.style, { width: `${100 * columns}%`, height: `${100 * rows}%`,
    marginLeft: `${-100 * (liveliest % columns)}%`, marginTop: `${-22 * Math.floor(liveliest / columns)}px` });
}

// Values that go to the row below lead straight down; all others through lanes at the left.
function drawLines(view, first, last) {
  const height = (last - first) * ROW.height, top = first * ROW.height;
  const root = svg("svg", { class: "lines", width: view.gutter + 40, height, viewBox: `0 ${top} ${view.gutter + 40} ${height}` });
  root.style.top = `${top}px`;
  const near = row => view.chosen !== null && row === view.places.node.get(view.chosen);
  for (const line of view.lines) {
    if (line.end < first || line.from > last) continue;
    const chosen = near(line.from) || near(line.next) || line.to.some(near);
    const group = svg("g", { class: `line lane${(line.lane ?? 0) % 4}${chosen ? " chosen" : ""}`, "data-value": line.name }, root);
    svg("path", { d: pathOf(view, line) }, group);
    for (const arrow of arrowsOf(view, line)) svg("path", { class: "tip", d: arrow }, group);
    svg("title", {}, group, `${line.name} ${sizes(view.values.get(line.name))}`);
  }
  return root;
}

function middle(row) {
  return (row + 0.5) * ROW.height;
}

function pathOf(view, line) {
  const x = view.gutter, spine = x + (line.constant ? 40 : 12), half = ROW.box / 2;
  const straight = line.next === null ? "" : `M${spine},${middle(line.from) + half} V${middle(line.next) - half}`;
  if (!line.to.length) return straight;
  const lane = x - ROW.before - line.lane * ROW.lane, leave = middle(line.from) + 5;
  const exits = line.to.map(row => `M${lane},${middle(row) - 9} q0,4 4,4 H${x}`).join(" ");
  return `${straight} M${x},${leave} H${lane + 4} q-4,0 -4,4 V${middle(line.end) - 9} ${exits}`;
}

function arrowsOf(view, line) {
  const x = view.gutter, spine = x + (line.constant ? 40 : 12), half = ROW.box / 2;
  const down = line.next === null ? [] : [`M${spine},${middle(line.next) - half} l-3.5,-5 h7 z`];
  return down.concat(line.to.map(row => `M${x},${middle(row) - 5} l-5,-3.5 v7 z`));
}
