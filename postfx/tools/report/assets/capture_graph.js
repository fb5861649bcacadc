// The dependency graph: one row for each command or barrier, one column for each encoder.
const BOX = { width: 190, height: 34, gap: 12, column: 280, top: 30, left: 16, barrier: 22 };

// Rows from top to bottom: {y, command} or {y, barrier} or {y, buffer}; columns: encoder number -> x.
function layout(data) {
  const columns = new Map(), names = new Map(), rows = [];
  let y = BOX.top;
  for (const buffer of data.buffers) {
    if (data.buffers.length > 1) { rows.push({ y, buffer }); y += 26; }
    for (const record of buffer.records) {
      const command = data.commands[record.dispatch];
      const encoder = command ? command.encoder : record.encoder;
      if (!columns.has(encoder)) columns.set(encoder, BOX.left + columns.size * BOX.column);
      if (command) names.set(encoder, command.label);
      rows.push({ y, command, barrier: command ? null : record, x: columns.get(encoder) });
      y += command ? BOX.height + BOX.gap + (outside(data, command).length ? 10 : 0) : BOX.barrier;
    }
  }
  return { columns, names, rows, width: BOX.left + columns.size * BOX.column, height: y + 10 };
}

function outside(data, command) {
  return data.edges.filter(edge => edge.from === null && edge.to === command.index).map(edge => edge.tensor);
}

function drawGraph(data, place, choose) {
  const plan = layout(data), at = new Map();
  const root = svg("svg", { width: plan.width, height: plan.height, role: "img", "aria-label": "dependency graph" });
  for (const [encoder, x] of plan.columns) {
    svg("rect", { class: "lane", x: x - 8, y: 0, width: BOX.width + 16, height: plan.height, rx: 6 }, root);
    const name = svg("text", { class: "lane-name", x, y: 18 }, root, shortened(plan.names.get(encoder) || "", 32));
    svg("title", {}, name, `encoder ${encoder}: ${plan.names.get(encoder)}`);
  }
  for (const row of plan.rows) if (row.command) at.set(row.command.index, { ...row, entries: 0 });
  for (const row of plan.rows) if (row.barrier) drawBarrier(row, plan, root);
  for (const row of plan.rows) if (row.buffer) svg("text", { x: 12, y: row.y + 14 }, root, row.buffer.label);
  for (const edge of data.edges) if (edge.from !== null) drawEdge(edge, at, root);
  for (const row of plan.rows) if (row.command) drawBox(row, outside(data, row.command), root, choose);
  root.addEventListener("click", event => { if (!event.target.closest(".box")) root.classList.remove("choosing"); });
  place.append(root);
}

function drawBox(row, inputs, root, choose) {
  const { command, x, y } = row;
  const group = svg("g", { class: `box ${command.stage}`, "data-command": command.index }, root);
  const box = svg("rect", { x, y, width: BOX.width, height: BOX.height, rx: 5 }, group);
  svg("title", {}, box, `${command.label}: ${command.command}`);
  svg("text", { x: x + 8, y: y + 14 }, group, shortened(`${command.index}  ${command.command}`, 32));
  const time = svg("text", { x: x + 8, y: y + 28, class: "time" }, group, state(command));
  if (command.error || troubles(command)) time.setAttribute("style", "fill: var(--bad)");
  if (inputs.length) {
    const text = svg("text", { class: "from-outside", x, y: y + BOX.height + 12 }, group,
      shortened("reads " + inputs.join(", "), 34));
    svg("title", {}, text, inputs.join(", "));
  }
  box.addEventListener("click", () => choose(command.index));
}

function drawBarrier(row, plan, root) {
  const { barrier, x, y } = row, own = barrier.barrier === "encoder", middle = y + 4;
  const group = svg("g", { class: "barrier", "data-form": barrier.barrier }, root);
  const from = own ? x - 8 : 0, to = own ? x + BOX.width + 8 : plan.width;
  svg("line", { x1: from, x2: to, y1: middle, y2: middle }, group);
  if (own) { svg("title", {}, group, "barrier inside the encoder"); return; }
  const text = `${barrier.after.join(", ")} \u2192 ${barrier.before.join(", ")} (${barrier.barrier})`;
  svg("text", { x, y: middle + 12 }, group, text);
}

// To a later encoder: down between the columns, then along the reader's row, which no other box stands in. Within one:
// an arc at the right, wider the longer it is.
function drawEdge(edge, at, root) {
  const from = at.get(edge.from), to = at.get(edge.to), right = from.x + BOX.width;
  const start = from.y + BOX.height / 2, end = to.y + BOX.height / 2;
  const group = svg("g", { class: "edge", "data-from": edge.from, "data-to": edge.to }, root);
  const bend = Math.min(14 + Math.abs(end - start) / 12, 48);
  const path = from.x === to.x
    ? `M${right},${start} C${right + bend},${start} ${right + bend},${end} ${right},${end}`
    : `M${right},${start} C${right + 44},${start} ${right},${end} ${right + 44},${end} L${to.x},${end}`;
  svg("path", { d: path }, group);
  const label = from.x === to.x ? { x: right + bend * 0.75 + 2, anchor: "start", y: (start + end) / 2 + 3 }
    : { x: to.x - 4, anchor: "end", y: end - 4 - 11 * to.entries++ };
  const text = svg("text", { x: label.x, y: label.y, "text-anchor": label.anchor }, group, shortened(edge.tensor, 18));
  svg("title", {}, text, `${edge.tensor}: command ${edge.from} to ${edge.to}`);
}
