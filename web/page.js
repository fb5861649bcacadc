// The page: takes a file, shows before and after, and follows the controls.

import { denoise, loadRuntime, meter, show } from "./frame.js";
import { findPlanes, readHeader, readPlane } from "./planes.js";

const MOST_PIXELS = 1920 * 1080; // of the output: what a browser's memory holds safely
const $ = (id) => document.getElementById(id);
const options = $("options").elements;
let runtime, frame, clean;

/** Planes of a file as Float32Arrays, with their size and where they came from. */
export function readFrame(buffer) {
  const parts = readHeader(buffer), found = findPlanes(parts);
  if (!found.colour) throw new Error("there is no colour: postfx needs channels R, G and B");
  const part = parts[found.colour.part], { width, height } = part, planes = {}, notes = {};
  for (const [name, place] of Object.entries(found)) {
    const other = parts[place.part];
    if (other.width !== width || other.height !== height) {
      notes[name] = "not used: it has another size";
      continue;
    }
    try {
      planes[name] = readPlane(buffer, parts, place);
      notes[name] = place.channels.join(", ");
    } catch (error) {
      if (name === "colour") throw error;
      notes[name] = `not used: ${error.message}`;
    }
  }
  return { planes, notes, width, height, jitter: part.jitter };
}

async function open(buffer) {
  tell("Reading the file ...");
  await painted();
  frame = readFrame(buffer);
  frame.stops = meter(frame.planes.colour, frame.width, frame.height);
  listPlanes();
  await process();
}

async function process() {
  const scale = Number(options.scale.value), { width, height } = frame;
  if (width * height * scale ** 2 > MOST_PIXELS) {
    const other = width * height <= MOST_PIXELS ? " as rendered here, or" : "";
    throw new Error(`${width * scale}x${height * scale} is too large for a browser: take it${other} to the program`);
  }
  runtime ??= await loadRuntime(new URLSearchParams(location.search).get("on") ?? "auto");
  tell(`Denoising ${width}x${height} on the ${runtime.provider === "webgpu" ? "GPU" : "CPU"} ...`);
  await painted();
  const begin = performance.now();
  clean = await denoised(options.network.value, scale);
  frame.seconds = (performance.now() - begin) / 1000;
  await draw();
}

async function denoised(network, scale) {
  try {
    return await denoise(runtime, frame, 2 ** frame.stops, network, scale);
  } catch (error) {
    if (runtime.provider !== "webgpu") throw error;
    runtime = await loadRuntime("wasm"); // a driver may lack something
    return denoise(runtime, frame, 2 ** frame.stops, network, scale);
  }
}

async function draw() {
  const exposure = 2 ** (frame.stops + Number(options.stops.value)), look = options.look.value;
  const before = { data: frame.planes.colour, width: frame.width, height: frame.height };
  for (const [id, picture] of [["before", before], ["after", clean]]) {
    const canvas = $(id);
    [canvas.width, canvas.height] = [picture.width, picture.height];
    canvas.getContext("2d").putImageData(await show(runtime, picture, exposure, look), 0, 0);
  }
  $("pictures").hidden = $("save").hidden = false;
  $("save").href = $("after").toDataURL("image/png");
  options.shown.value = `${(frame.stops + Number(options.stops.value)).toFixed(1)} EV`;
  enlarge();
  tell(`${frame.width}x${frame.height} to ${clean.width}x${clean.height} in ${frame.seconds.toFixed(1)} s`);
}

/** Makes a pixel of the result as large as the control says; "fit" takes the page's width. */
function enlarge() {
  const zoom = Number(options.zoom.value);
  $("pictures").style.width = zoom ? `${zoom * clean.width}px` : "";
  $("after").style.imageRendering = zoom ? "pixelated" : "";
  divide();
}

/** All controls as at the start; the frame stays. */
async function reset() {
  await painted(); // the form's own values are there after the event
  $("split").value = 50;
  if (frame) await process();
}

function divide() {
  const share = Number($("split").value);
  $("before").style.clipPath = `inset(0 ${100 - share}% 0 0)`;
  $("before").style.height = $("line").style.height = `${$("after").clientHeight}px`;
  $("line").style.left = `${share}%`;
}

function listPlanes() {
  const table = $("planes");
  table.hidden = false;
  table.replaceChildren(table.caption);
  for (const name of ["colour", "diffuse_albedo", "specular_albedo", "normal", "depth", "roughness", "motion"]) {
    const row = table.insertRow();
    row.insertCell().textContent = name.replace("_", " ");
    row.insertCell().textContent = frame.notes[name] ?? "not there";
  }
}

function tell(text, kind = "") {
  [$("status").textContent, $("status").className] = [text, kind];
}

const painted = () => new Promise((resolve) => requestAnimationFrame(() => setTimeout(resolve)));
const shown = (work) => work.catch((error) => tell(error.message, "error"));

$("file").addEventListener("change", async ({ target }) => shown(open(await target.files[0].arrayBuffer())));
$("sample").addEventListener("click", async () => shown(open(await (await fetch("sample.exr")).arrayBuffer())));
for (const name of ["network", "scale"]) options[name].addEventListener("change", () => frame && shown(process()));
options.look.addEventListener("change", () => clean && shown(draw()));
options.stops.addEventListener("change", () => clean && shown(draw()));
options.zoom.addEventListener("change", () => clean && enlarge());
$("options").addEventListener("reset", () => shown(reset()));
$("split").addEventListener("input", divide);
addEventListener("resize", () => clean && divide());
for (const kind of ["dragover", "dragleave", "drop"]) {
  addEventListener(kind, (event) => {
    event.preventDefault();
    $("drop").classList.toggle("over", kind === "dragover");
    const file = kind === "drop" && event.dataTransfer.files[0];
    if (file) file.arrayBuffer().then((buffer) => shown(open(buffer)));
  });
}
