// A frame through postfx's models: exposure, denoising, look. Models are made by web/export.py.

const CHANNELS = { colour: 3, diffuse_albedo: 3, specular_albedo: 3, normal: 3, roughness: 1, depth: 1, motion: 2 };
const ABSENT = { roughness: 0.5, depth: 1 }; // and 0: what stands for a plane that a frame lacks
const HAZY = ["diffuse_albedo", "specular_albedo", "depth"]; // planes that a volume hides
const MISS = 1e10, FARTHEST = 1e9, FOUND = 0.12;
// Metering: see postfx/exposure.py.
const [KEY, BLACK, RANGE_EV, BLOCK, MOST_BLOCKS, LIMIT_EV] = [0.18, 2 ** -24, 9, 8, 160, 16];

/** ONNX Runtime on the GPU where the browser has WebGPU, else on the CPU; and which of both. */
export async function loadRuntime(wanted = "auto") {
  const adapter = wanted === "wasm" ? null : await navigator.gpu?.requestAdapter().catch(() => null);
  const isSlow = adapter?.info?.isFallbackAdapter && wanted === "auto"; // a GPU that the CPU imitates
  const provider = adapter && !isSlow ? "webgpu" : "wasm";
  const ort = await import(provider === "webgpu" ? "onnxruntime-web/webgpu" : "onnxruntime-web/wasm");
  ort.env.wasm.wasmPaths = new URL("ort/", document.baseURI).href;
  if (!globalThis.crossOriginIsolated) ort.env.wasm.numThreads = 1; // threads need headers that a plain server lacks
  return { ort, provider, sessions: new Map() };
}

async function run(runtime, model, feeds) {
  const { ort, provider, sessions } = runtime;
  if (!sessions.has(model)) {
    const options = { executionProviders: provider === "webgpu" ? ["webgpu", "wasm"] : ["wasm"] };
    sessions.set(model, await ort.InferenceSession.create(`models/${model}.onnx`, options));
  }
  const { output } = await sessions.get(model).run(feeds);
  return output;
}

/** Clean colour of a frame: { data, width, height }. `planes` are Float32Arrays by name; `network` is s
 * or m, `scale` 1 or 2. */
export async function denoise(runtime, { planes, width, height, jitter = [0, 0] }, exposure, network, scale) {
  const feeds = { params: new runtime.ort.Tensor("float32", Float32Array.of(exposure, ...jitter, 1), [4]) };
  const hidden = planes.depth && showsVolume(planes.depth, width, height) ? HAZY : [];
  for (const [name, channels] of Object.entries(CHANNELS)) {
    const given = hidden.includes(name) ? null : planes[name];
    const data = given ?? new Float32Array(width * height * channels).fill(ABSENT[name] ?? 0);
    feeds[name] = new runtime.ort.Tensor("float32", cleaned(name, data), [height, width, channels]);
  }
  const output = await run(runtime, `denoise.${network}.${scale}x`, feeds);
  return { data: output.data, width: output.dims[1], height: output.dims[0] };
}

/** Whether hits and misses of depth are noise: see shows_volume in postfx/passes/denoise/planes.py. */
export function showsVolume(depth, width, height) {
  const isHit = depth.map((value) => value > 0 && value < FARTHEST);
  let [noisy, rows] = [0, 0];
  for (let y = 1; y < height - 1; y += 2, rows++) {
    for (let i = y * width + 1; i < (y + 1) * width - 1; i++) {
      const around = isHit[i - width] + isHit[i + width] + isHit[i - 1] + isHit[i + 1];
      noisy += isHit[i] ? around <= 1 : around >= 3;
    }
  }
  return noisy > FOUND * Math.max(rows * (width - 2), 1);
}

/** Numbers as postfx reads them: no NaN, depth of misses beyond everything. */
function cleaned(name, data) {
  if (name === "depth") return data.map((value) => (value > 0 && value < MISS ? value : MISS));
  const [least, most] = name.endsWith("albedo") ? [0, 1] : [-65504, 65504];
  return data.map((value) => (Number.isNaN(value) ? 0 : Math.min(Math.max(value, least), most)));
}

/** A look of scene-linear colour: code values for the canvas, 0 to 255, RGBA. */
export async function show(runtime, { data, width, height }, exposure, look) {
  const feeds = { colour: new runtime.ort.Tensor("float32", data, [height, width, 3]),
                  exposure: new runtime.ort.Tensor("float32", Float32Array.of(exposure), [1]) };
  const codes = (await run(runtime, `look.${look}`, feeds)).data, pixels = new Uint8ClampedArray(width * height * 4);
  for (let i = 0; i < width * height; i++) {
    for (let c = 0; c < 3; c++) pixels[4 * i + c] = 255 * codes[3 * i + c];
    pixels[4 * i + 3] = 255;
  }
  return new ImageData(pixels, width, height);
}

/** Stops that bring a picture to mid grey; 0 for a black one. */
export function meter(colour, width, height) {
  const block = Math.max(BLOCK, Math.ceil(Math.max(width, height) / MOST_BLOCKS)), logs = [];
  for (let top = 0; top < height; top += block) {
    for (let left = 0; left < width; left += block) {
      const mean = blockMean(colour, width, top, left, Math.min(top + block, height), Math.min(left + block, width));
      if (mean > BLACK) logs.push(Math.log2(mean));
    }
  }
  if (!logs.length) return 0;
  logs.sort((a, b) => a - b);
  const last = logs.length - 1, low = logs[Math.floor(0.02 * last)], high = logs[Math.ceil(0.98 * last)];
  const inner = logs.filter((log) => log >= low && log <= high).map((log) => Math.max(log, high - RANGE_EV));
  const ev = Math.log2(KEY) - inner.reduce((sum, log) => sum + log, 0) / inner.length;
  return Math.min(Math.max(ev, -LIMIT_EV), LIMIT_EV);
}

/** Mean luminance of a block of pixels without the brightest. */
function blockMean(colour, width, top, left, bottom, right) {
  let [total, brightest, count] = [0, 0, 0];
  for (let y = top; y < bottom; y++) {
    for (let x = left; x < right; x++) {
      const i = 3 * (y * width + x);
      const light = 0.2126 * colour[i] + 0.7152 * colour[i + 1] + 0.0722 * colour[i + 2];
      if (!Number.isFinite(light)) continue;
      total += Math.max(light, 0);
      brightest = Math.max(brightest, light);
      count++;
    }
  }
  return count > 1 ? (total - brightest) / (count - 1) : total;
}
