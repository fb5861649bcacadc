const networks = new Map();  // command -> its network's drawing
const busy = data.commands.reduce((sum, command) => sum + (command.ms || 0), 0);

function bytes(count) {
  if (count < 1000) return `${count} B`;
  const step = Math.min(3, Math.floor(Math.log10(count) / 3));
  return `${(count / 1000 ** step).toPrecision(3)} ${["B", "kB", "MB", "GB"][step]}`;
}

function sum(tensors) {
  return tensors.reduce((total, tensor) => total + tensor.bytes, 0);
}

function state(command) {
  if (command.error) return "failed";
  return command.ms === null ? "did not run" : `${command.ms.toFixed(2)} ms`;
}

// What is not finite in what a command wrote, as text; empty when all is.
function troubles(command) {
  const all = command.writes.filter(tensor => tensor.statistics).map(tensor => tensor.statistics);
  const nans = all.reduce((n, s) => n + s.nans, 0), infinities = all.reduce((n, s) => n + s.infinities, 0);
  return [nans && `${nans} NaN`, infinities && `${infinities} infinite`].filter(Boolean).join(", ");
}

function drawSummary() {
  const buffers = data.buffers.map(({ label, heap }) =>
    `${label}: heap ${bytes(heap.used)} in use, ${bytes(heap.peak)} peak, ${bytes(heap.size)} held`);
  document.getElementById("summary").textContent = `${data.commands.length} commands, ${busy.toFixed(2)} ms of their own, `
    + `on ${data.device.name} with ${data.device.threads} threads. ${buffers.join("; ")}. postfx ${data.postfx}`;
}

function drawCommands() {
  const table = document.getElementById("commands");
  const head = element("tr", element("thead", table));
  const names = ["#", "encoder", "command", "ms", "share", "", "reads", "writes", "not finite"];
  for (const name of names) element("th", head, name, /^(#|ms|share|reads|writes)$/.test(name) ? "number" : "");
  const body = element("tbody", table);
  let before = 0;
  for (const command of data.commands) {
    const row = element("tr", body), share = busy ? (command.ms || 0) / busy : 0;
    row.dataset.command = command.index;
    element("button", element("td", row, undefined, "number"), String(command.index));
    element("td", row, command.label);
    element("td", row, command.command);
    element("td", row, command.ms === null ? state(command) : command.ms.toFixed(2), command.ms === null ? "bad" : "number");
    element("td", row, `${(100 * share).toFixed(1)} %`, "number");
    const bar = element("div", element("td", row, undefined, "timeline"), undefined, `bar ${command.stage}`);
    bar.style.left = `${100 * before}%`;
    bar.style.width = `${100 * share}%`;
    before += share;
    element("td", row, bytes(sum(command.reads)), "number");
    element("td", row, bytes(sum(command.writes)), "number");
    element("td", row, troubles(command), "bad");
    row.addEventListener("click", () => choose(command.index));
  }
}

function drawTensor(tensor, writer, parent) {
  element("h3", parent, tensor.name);
  const [start, end] = tensor.address.map(place => "0x" + place.toString(16));
  element("p", parent, `(${tensor.shape.join(", ")}) ${tensor.dtype}, ${bytes(tensor.bytes)}, ${start} to ${end}`, "figures");
  if (writer.length) element("p", parent, `written by ${writer.join(", ")}`, "figures");
  if (tensor.statistics) drawStatistics(tensor, parent);
}

// Figures, small values and pictures of what was kept of a tensor.
function drawStatistics(tensor, parent) {
  const found = tensor.statistics;
  const range = `${figure(found.minimum)} to ${figure(found.maximum)}, mean ${figure(found.mean)}`;
  element("p", parent, `${range}, ${(100 * found.zeros).toFixed(1)} % zeros`, "figures");
  const wrong = `${found.nans} NaN, ${found.infinities} infinite`;
  element("p", parent, wrong, found.nans || found.infinities ? "bad" : "figures");
  if (tensor.values) element("p", parent, `values: ${tensor.values.map(figure).join(" ")}`, "figures");
  if (tensor.pictures !== null && tensor.pictures !== undefined) drawPictures(tensor, data.pictures[tensor.pictures], parent);
  if (tensor.file) element("p", parent, `all of it: ${tensor.file}`, "figures");
}

function drawPictures(tensor, pictures, parent) {
  const image = element("img", parent), caption = element("p", parent, undefined, "figures");
  const show = number => {
    const shown = pictures[number];
    image.src = shown.src;
    image.alt = `${tensor.name}, ${shown.label}`;
    caption.textContent = `${shown.label} of ${tensor.channels}; ${shown.range}`;
  };
  show(0);
  if (pictures.length === 1) return;
  const slider = element("input");
  Object.assign(slider, { type: "range", min: 0, max: pictures.length - 1, value: 0 });
  slider.setAttribute("aria-label", `channel of ${tensor.name}`);
  slider.addEventListener("input", () => show(Number(slider.value)));
  image.before(slider);
}

// What a command read, with what was kept of it when it was written.
function asWritten(tensor, writers) {
  const written = writers.flatMap(from => from === null ? [] : data.commands[from].writes);
  const same = written.find(other => other.address.join() === tensor.address.join() && other.statistics);
  return tensor.statistics || !same ? tensor : { ...same, name: tensor.name, shape: tensor.shape };
}

function drawDetails(command) {
  const panel = document.getElementById("details");
  panel.replaceChildren();
  element("h2", panel, `${command.index}  ${command.command}`).style.marginTop = "0";
  element("p", panel, `${command.label}, ${command.stage}, encoder ${command.encoder}: ${state(command)}`, "figures");
  if (command.error) element("p", panel, command.error, "bad");
  const graph = networks.get(command.index);
  if (graph) element("button", panel, "its graph").addEventListener("click", () => graph.show(command.index));
  for (const [title, tensors] of [["Writes", command.writes], ["Reads", command.reads]]) {
    element("h2", panel, title);
    for (const tensor of tensors) {
      const into = title === "Writes" ? []
        : data.edges.filter(edge => edge.to === command.index && edge.tensor === tensor.name).map(edge => edge.from);
      const writers = into.map(from => from === null ? "no command of this capture" : `command ${from}`);
      drawTensor(asWritten(tensor, into), writers, panel);
    }
  }
}

// Shows a command; `isolate` fades the lines of all others.
function choose(index, isolate = true) {
  drawDetails(data.commands[index]);
  for (const marked of document.querySelectorAll("[data-command]"))
    marked.classList.toggle("chosen", Number(marked.dataset.command) === index);
  for (const edge of document.querySelectorAll(".edge"))
    edge.classList.toggle("chosen", [edge.dataset.from, edge.dataset.to].includes(String(index)));
  document.querySelector("#graph svg").classList.toggle("choosing", isolate);
}

// Draws a network's graph when it is opened for the first time.
function drawNetwork(network, place) {
  const box = element("details", place), sizes = Object.values(network.weights);
  const count = sizes.reduce((total, weight) => total + weight.shape.reduce((a, b) => a * b, 1), 0);
  const dims = Object.entries(network.dims).map(([name, size]) => `${name} ${size}`).join(", ");
  element("summary", box, [network.name, dims].filter(Boolean).join(", ") + ": " + (network.note
    || `${network.nodes.length} nodes, ${count} parameters in ${bytes(sum(sizes))}`));
  element("p", box, network.file, "figures");
  if (network.note) return;
  let view = null;
  const draw = () => { view = view || new NetworkView(network, box); };
  box.addEventListener("toggle", () => { if (box.open) draw(); });
  const show = command => {
    box.open = true;
    draw();
    view.select(command);
    view.update();
    box.scrollIntoView({ behavior: "smooth" });
  };
  const handle = { show, node: number => { box.open = true; draw(); view.choose(number); } };
  for (const command of network.commands) networks.set(command, handle);
}

function drawNetworks() {
  const place = document.getElementById("networks");
  for (const network of data.networks) drawNetwork(network, place);
  const first = place.querySelector("details");
  if (first) first.open = true;
  if (!data.networks.length) element("p", place, "No network ran.", "note");
}

drawSummary();
drawCommands();
drawGraph(data, document.getElementById("graph"), choose);
drawNetworks();
if (data.commands.length) choose(data.commands.reduce((a, b) => ((b.ms || 0) > (a.ms || 0) ? b : a)).index, false);
