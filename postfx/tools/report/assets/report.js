const VERDICTS = { error: "there are errors", warning: "there are warnings" };

const countFrames = count => `${count} frame${count === 1 ? "" : "s"}`;

function row(table, cells, head = false) {
  const line = element("tr", table);
  for (const cell of cells) {
    if (cell instanceof Node) line.append(cell);
    else element(head ? "th" : "td", line, cell);
  }
  return line;
}

// Of every view; which one says the evidence.
function allFindings() {
  return Object.entries(data.views).flatMap(([view, { findings }]) => findings.map(
    finding => ({ ...finding, evidence: view ? `${view}: ${finding.evidence}` : finding.evidence })));
}

function drawSummary() {
  const { facts, run } = data, { frames } = facts, worst = allFindings().map(finding => finding.level);
  const verdict = VERDICTS[["error", "warning"].find(level => worst.includes(level))] || "nothing wrong was found";
  const count = frames.count > 1 ? `${frames.count} frames, ${frames.first} to ${frames.last}` : "1 frame";
  const size = run ? `, ${run.frames} written` : "";
  document.getElementById("summary").textContent = `${facts.source}: ${count}, ${facts.width}x${facts.height}${size}. `
    + `Input: ${verdict}. postfx ${data.postfx}`;
}

function drawFindings() {
  const table = document.getElementById("findings"), { examined } = data.facts, findings = allFindings();
  if (!findings.length) element("caption", table, `None, in ${countFrames(examined.length)} that ${examined.length === 1 ? "was" : "were"} looked at.`, "note");
  else row(table, ["", "what", "evidence", "likely cause and fix"], true);
  for (const finding of findings) {
    const level = element("td", null, finding.level, `level ${finding.level}`), cause = element("td", null, finding.cause);
    element("div", cause, finding.fix, "fix");
    row(table, [level, `${finding.code} (${finding.role})`, finding.evidence, cause]);
  }
}

function drawSheet() {
  const place = document.getElementById("sheet");
  for (const { view, name, src, size } of data.sheet) {
    const title = view ? `${view} ${name}` : name;
    const box = element("figure", place), button = element("button", box), image = element("img", button);
    image.src = src;
    image.alt = title;
    button.addEventListener("click", () => box.classList.toggle("open"));
    element("figcaption", box, `${title}, ${size[0]}x${size[1]}`);
    element("p", box, rangeOf(name, data.views[view]), "figures");
  }
}

// Least and largest value of a plane, and what is odd in it.
function rangeOf(name, { planes, guides }) {
  const own = name.startsWith("guide ") && guides ? guides.planes : planes;
  const plane = own.find(({ role }) => role === name.replace("guide ", ""));
  if (!plane) return "";
  const odd = [[plane.misses, "misses"], [plane.nan, "NaN"], [plane.infinite, "infinite"]].filter(([found]) => found);
  const range = plane.min === null ? "no value" : `${plane.min.toPrecision(4)} to ${plane.max.toPrecision(4)}`;
  return [range, ...odd.map(([found, what]) => `${found} ${what}`)].join(", ");
}

function drawRoles() {
  const table = document.getElementById("roles");
  row(table, ["role", "channels", "why"], true);
  for (const [view, { roles }] of Object.entries(data.views))
    for (const [role, { planes, why, guides }] of Object.entries(roles)) {
      const channels = [planes.join(", ") || "none", guides ? `guides ${guides.join(", ")}` : ""].filter(Boolean).join("; ");
      row(table, [view ? `${view} ${role}` : role, channels, why]);
    }
}

function drawRun() {
  const place = document.getElementById("ran"), { run, facts } = data;
  if (!run) { place.remove(); return; }
  if (run.error) element("p", place, `The run ended early: ${run.error}`, "bad");
  const ms = run.ms_per_frame, speed = ms ? `, ${ms.median.toFixed(0)} ms a frame in the passes (${ms.min.toFixed(0)} to ${ms.max.toFixed(0)})` : "";
  element("p", place, `${run.frames} of ${countFrames(facts.frames.count)} in ${run.seconds.toFixed(1)} s${speed}.`);
  const table = element("table", place);
  row(table, ["", "what", "time, choice or reason"], true);
  for (const [name, time] of Object.entries(run.passes)) {
    const chosen = Object.entries(run.chosen[name] || {}).map(([model, count]) => `; ${model} for ${countFrames(count)}`).join("");
    row(table, ["ran", name, `${time.toFixed(2)} ms a frame${chosen}`]);
  }
  if (run.pixel_filter) row(table, ["undid", "pixel filter", `${run.pixel_filter.toFixed(2)} px before denoising, and applied to the picture`]);
  for (const { what, why } of run.skipped) row(table, ["skipped", what, why]);
  for (const warning of [...run.warnings, ...facts.warnings.filter(text => !run.warnings.includes(text))]) row(table, ["warning", "", warning]);
  if (run.cuts.length) row(table, ["cuts", "", `found at ${run.cuts.join(", ")}`]);
  if (run.outputs.length) row(table, ["wrote", "", run.outputs.length > 1 ? `${run.outputs[0]} to ${run.outputs.at(-1)}` : run.outputs[0]]);
  const more = element("details", place);
  element("summary", more, "the plan");
  element("pre", more, run.plan);
}

drawSummary();
drawFindings();
for (const chart of data.charts) drawChart(chart, document.getElementById("charts"));
if (!data.charts.length) element("p", document.getElementById("charts"), "Too few frames for a curve.", "note");
drawRun();
drawSheet();
drawRoles();
const viewer = data.frames.length ? new Viewer() : document.getElementById("frames").remove();
