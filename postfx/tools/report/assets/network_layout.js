// A network's graph as rows from top to bottom and lines between them; nothing here touches the page.
const MOST_LANES = 24;

// Rows: {kind: "input" | "output", name}, {kind: "block", block, nodes, open} and {kind: "node", node, block, inside}.
// `view` has `open`, the numbers of the blocks that are open, and whether `constants` are shown.
function networkRows(network, view) {
  const rows = network.inputs.map((name, order) => ({ kind: "input", name, order }));
  network.blocks.forEach((block, number) => {
    const nodes = block.filter(node => view.constants || !network.nodes[node].constant);
    const open = view.open.has(number), inside = nodes.length > 1;
    if (inside) rows.push({ kind: "block", block: number, nodes, open });
    if (open || !inside) for (const node of nodes) rows.push({ kind: "node", node, block: number, inside });
  });
  return rows.concat(network.outputs.map(name => ({ kind: "output", name })));
}

// Lines: one for each value, {name, from, next, to, end, lane, constant}. `next` is the row right below that reads it,
// or null; `to` are all other readers' rows, which a lane at the left leads to, down to the row `end`.
function networkLines(network, rows) {
  const place = placesOf(rows), order = boxOrder(network, rows), readers = readersOf(network, place.node, place.output);
  const lines = [];
  const add = (name, from, constant) => {
    if (from === undefined) return;
    const to = [...new Set(readers.get(name) || [])].filter(row => row !== from).sort((a, b) => a - b);
    const next = to.find(row => constant || order[row] === order[from] + 1) ?? null;
    const rest = constant ? [] : to.filter(row => row !== next);
    if (to.length) lines.push({ name, from, next, to: rest, end: rest.at(-1) ?? next, lane: null, constant });
  };
  network.inputs.forEach((name, number) => add(name, number, false));
  network.nodes.forEach((node, number) =>
    node.outputs.forEach(name => name && add(name, place.node.get(number), node.constant)));
  giveLanes(lines.filter(line => line.to.length));
  return lines;
}

// The row of every node, that of its block where this is closed, and of every output of the graph.
function placesOf(rows) {
  const node = new Map(), output = new Map();
  rows.forEach((row, number) => {
    if (row.kind === "node") node.set(row.node, number);
    if (row.kind === "block" && !row.open) for (const inner of row.nodes) node.set(inner, number);
    if (row.kind === "output") output.set(row.name, number);
  });
  return { node, output };
}

// How many boxes stand above each row: neither heads of open blocks nor constants count.
function boxOrder(network, rows) {
  let count = 0;
  return rows.map(row => {
    const counts = !(row.kind === "block" && row.open) && !(row.kind === "node" && network.nodes[row.node].constant);
    return counts ? ++count : count;
  });
}

function readersOf(network, nodeRow, outputRow) {
  const readers = new Map();
  const add = (name, row) => {
    if (!name || row === undefined) return;
    if (!readers.has(name)) readers.set(name, []);
    readers.get(name).push(row);
  };
  network.nodes.forEach((node, number) => node.inputs.forEach(name => add(name, nodeRow.get(number))));
  outputRow.forEach((row, name) => add(name, row));
  return readers;
}

// Short lines get the inner lanes, so that skip connections lie around what they skip. Where there would be too many
// lanes, the outermost is shared.
function giveLanes(lines) {
  const lanes = [];
  for (const line of [...lines].sort((a, b) => (a.end - a.from) - (b.end - b.from) || a.from - b.from)) {
    const free = lanes.findIndex(taken => taken.every(other => other.end <= line.from || line.end <= other.from));
    line.lane = free >= 0 ? free : Math.min(lanes.length, MOST_LANES - 1);
    if (!lanes[line.lane]) lanes[line.lane] = [];
    lanes[line.lane].push(line);
  }
}
