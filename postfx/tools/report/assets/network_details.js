// Everything about one node, beside the graph.
function drawNodeDetails(view, number) {
  const { network } = view, node = network.nodes[number], ran = view.ran.get(number);
  const panel = document.getElementById("details");
  panel.replaceChildren();
  panel.scrollTop = 0;
  element("h2", panel, `${number}  ${node.op}`).style.marginTop = "0";
  const own = [node.name, node.domain, node.constant && "constant", network.name].filter(Boolean).join(", ");
  element("p", panel, own, "figures");
  if (ran) element("p", panel, ran.ms === null ? "failed" : `${ran.ms.toFixed(3)} ms by itself`, "figures");
  if (ran && ran.error) element("p", panel, ran.error, "bad");
  drawAttributes(node, panel);
  const readers = name => network.nodes.flatMap((other, n) => other.inputs.includes(name) ? [n] : []);
  const writers = name => network.nodes.flatMap((other, n) => other.outputs.includes(name) ? [n] : []);
  element("h2", panel, "Outputs");
  for (const name of node.outputs.filter(Boolean)) drawNodeValue(view, name, "read by", readers(name), panel);
  const inputs = [...new Set(node.inputs)].filter(name => name && !network.weights[name]);
  if (inputs.length) element("h2", panel, "Inputs");
  for (const name of inputs) drawNodeValue(view, name, "written by", writers(name), panel);
  if (node.weights.length) element("h2", panel, "Weights");
  for (const name of node.weights) drawWeight(name, network.weights[name], panel);
}

function drawAttributes(node, panel) {
  const entries = Object.entries(node.attributes);
  if (!entries.length) return;
  const table = element("table", panel);
  for (const [key, value] of entries) {
    const row = element("tr", table);
    element("th", row, key);
    element("td", row, Array.isArray(value) ? value.join(", ") : String(value));
  }
}

function drawNodeValue(view, name, relation, nodes, panel) {
  const value = view.values.get(name), { network } = view;
  element("h3", panel, name);
  const line = element("p", panel, value ? `(${(value.shape || ["?"]).join(", ")}) ${value.dtype}` : "", "figures");
  if (value && value.bytes) line.append(`, ${bytes(value.bytes)}`);
  const place = [network.inputs.includes(name) && "input of the network", network.outputs.includes(name) && "output of the network"];
  for (const text of place.filter(Boolean)) line.append(`, ${text}`);
  if (nodes.length) {
    const links = element("p", panel, `${relation} `, "figures");
    for (const number of nodes) {
      element("button", links, `${number} ${network.nodes[number].op}`).addEventListener("click", () => view.choose(number));
      links.append(" ");
    }
  }
  if (value && value.statistics) drawStatistics(value, panel);
}

function drawWeight(name, weight, panel) {
  element("h3", panel, name);
  element("p", panel, `(${weight.shape.join(", ")}) ${weight.dtype}, ${bytes(weight.bytes)}`, "figures");
  if (weight.statistics) drawStatistics({ ...weight, name, pictures: null }, panel);
}
