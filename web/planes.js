// Planes of a frame from an OpenEXR file.
//
// three.js's EXRLoader decodes most compressions, but gives channels named R, G, B, A or Y alone. So the header is
// rewritten before each call: the channels of one plane get these names, all others get names that it does not know.

import { EXRLoader } from "three/addons/loaders/EXRLoader.js";
import { FloatType, RedFormat, RGBAFormat } from "three";

const MAGIC = 20000630;
const [MULTI_PART, DEEP] = [16, 8];
const [UINT, FLOAT] = [0, 2];
const PIZ = 4; // the loader takes all its channels for one type
// Compressions that cannot be read; of DWA the loader reads colour alone, of the others nothing.
const UNREAD = { 8: "DWAA", 9: "DWAB", 10: "HTJ2K", 11: "HTJ2K", 12: "LJ2K", 13: "ZSTD" };
const LAST_READ = 7;

// Plane -> names of its layer, best first, its letters, and what its numbers are multiplied by. "" is no layer.
const PLANES = {
  colour: { layers: ["", "rgba", "beauty", "combined", "image"], letters: ["RGB"] },
  diffuse_albedo: { layers: ["albedo", "diffuse_albedo", "diffuse color", "diffcol", "denoise_albedo",
                             "denoising albedo"], letters: ["RGB", "XYZ"] },
  specular_albedo: { layers: ["specular_albedo", "glossy color", "glosscol"], letters: ["RGB", "XYZ"] },
  normal: { layers: ["normal", "n", "nn", "sh_normal", "denoising normal"], letters: ["XYZ", "RGB"] },
  depth: { layers: ["depth", "z", "", "denoising depth"], letters: ["Z", "V", "T", "Y"] },
  roughness: { layers: ["roughness", "denoising roughness"], letters: ["Y", "V", "X", "R"] },
  motion: { layers: ["motion"], letters: ["XY"] },
};
const CYCLES_MOTION = { layers: ["vector"], letters: ["XY"], scale: [1, -1] }; // Cycles counts y upwards

/** What an OpenEXR file holds: [{ name, channels: [{ name, type }], width, height, compression, ... }], one a part. */
export function readHeader(buffer) {
  const view = new DataView(buffer), bytes = new Uint8Array(buffer);
  if (buffer.byteLength < 8 || view.getUint32(0, true) !== MAGIC) throw new Error("this is not an OpenEXR file");
  const flags = view.getUint8(5);
  if (flags & DEEP) throw new Error("deep files cannot be read here: flatten them first");
  let at = 8;
  const text = () => {
    const end = bytes.indexOf(0, at);
    if (end < 0) throw new Error("the header is cut short");
    const found = new TextDecoder().decode(bytes.subarray(at, end));
    at = end + 1;
    return found;
  };
  const parts = [];
  do {
    const part = { name: "", attributes: {} };
    for (let name = text(); name; name = text()) {
      const type = text(), size = view.getUint32(at, true);
      part.attributes[name] = { type, sizeAt: at, at: at + 4, size };
      at += 4 + size;
      if (at > bytes.length) throw new Error("the header is cut short");
    }
    if (!Object.keys(part.attributes).length) break;
    parts.push(complete(part, view, bytes));
  } while (flags & MULTI_PART);
  parts.tablesAt = at;
  parts.multiPart = Boolean(flags & MULTI_PART);
  return parts;
}

function complete(part, view, bytes) {
  const { channels, dataWindow, compression, name } = part.attributes;
  if (!channels || !dataWindow || !compression) throw new Error("the header lacks channels or a data window");
  const [left, top, right, bottom] = [0, 4, 8, 12].map((i) => view.getInt32(dataWindow.at + i, true));
  if (name) part.name = new TextDecoder().decode(bytes.subarray(name.at, name.at + name.size));
  part.compression = view.getUint8(compression.at);
  part.width = right - left + 1;
  part.height = bottom - top + 1;
  part.channels = [];
  const last = channels.at + channels.size;
  for (let at = channels.at; at < last && bytes[at]; at += 16) {
    const end = bytes.indexOf(0, at);
    if (end < 0 || end + 17 > last) throw new Error("the list of channels is cut short");
    const channel = { name: new TextDecoder().decode(bytes.subarray(at, end)) };
    at = end + 1;
    channel.type = view.getInt32(at, true);
    channel.rest = bytes.slice(at + 4, at + 16); // linearity and sampling
    part.channels.push(channel);
  }
  const number = (key) => {
    const found = part.attributes[key];
    return found?.type === "float" ? view.getFloat32(found.at, true) : undefined;
  };
  const chunks = part.attributes.chunkCount;
  part.chunkCount = chunks && view.getInt32(chunks.at, true);
  const jitter = part.attributes["postfx:jitter"];
  part.jitter = jitter?.type === "v2f" ? [0, 4].map((i) => view.getFloat32(jitter.at + i, true)) : [0, 0];
  part.exposure = number("postfx:exposure");
  return part;
}

/** Which channels are which plane: plane -> { part, channels: [names], scale }. */
export function findPlanes(parts) {
  const found = {};
  for (const [plane, rule] of Object.entries(PLANES)) {
    found[plane] = findPlane(parts, rule) ?? (plane === "motion" ? findPlane(parts, CYCLES_MOTION) : undefined);
    if (!found[plane]) delete found[plane];
  }
  return found;
}

function findPlane(parts, { layers, letters, scale }) {
  for (const layer of layers) {
    for (const set of letters) {
      for (const [index, part] of parts.entries()) {
        const channels = [...set].map((letter) => part.channels.find(({ name }) => {
          const words = (parts.multiPart && !name.includes(".") ? `${part.name}.${name}` : name).split(".");
          const [last, before] = [words.pop(), words.pop() ?? ""];
          const own = parts.multiPart && words.length === 0 && layer === "" && index === 0 && !name.includes(".");
          return last.toUpperCase() === letter && (before.toLowerCase() === layer || own);
        })?.name);
        if (channels.every(Boolean)) return { part: index, channels, scale };
      }
    }
  }
  return undefined;
}

/** A plane's numbers, Float32Array of (height, width, channels), from the first row on. */
export function readPlane(buffer, parts, { part, channels, scale }) {
  const { width, height } = parts[part], count = channels.length, plane = new Float32Array(width * height * count);
  const groups = count === 3 && alike(parts[part], channels) ? [channels] : channels.map((name) => [name]);
  groups.forEach((group, first) => {
    const data = decode(buffer, parts, part, group), step = group.length === 3 ? 4 : 1;
    for (let y = 0; y < height; y++) {
      for (let x = 0; x < width; x++) {
        for (let c = 0; c < group.length; c++) { // the loader's first row is the lowest
          const value = data[((height - 1 - y) * width + x) * step + c];
          plane[(y * width + x) * count + first + c] = scale ? value * scale[first + c] : value;
        }
      }
    }
  });
  return plane;
}

function alike(part, names) {
  return new Set(names.map((name) => part.channels.find((channel) => channel.name === name).type)).size === 1;
}

function decode(buffer, parts, index, names) {
  const { compression, channels } = parts[index];
  if (compression > LAST_READ) {
    const name = UNREAD[compression] ?? `compression ${compression}`;
    throw new Error(`${name} cannot be read here: save the file as ZIP, or take it to the program`);
  }
  if (compression === PIZ && !alike(parts[index], channels.map(({ name }) => name))) {
    throw new Error("PIZ of half and float channels in one part cannot be read here: save the file as ZIP");
  }
  const letters = names.length === 3 ? ["R", "G", "B"] : ["Y"];
  const loader = new EXRLoader();
  loader.type = FloatType;
  loader.outputFormat = letters.length === 3 ? RGBAFormat : RedFormat;
  loader.part = index;
  return loader.parse(renamed(buffer, parts, index, new Map(names.map((name, i) => [name, letters[i]])))).data;
}

/** The file with other names of channels in one part, which move what comes behind them. */
function renamed(buffer, parts, index, names) {
  const bytes = new Uint8Array(buffer), { at, size, sizeAt } = parts[index].attributes.channels;
  const list = [];
  parts[index].channels.forEach(({ name, type, rest }, i) => {
    list.push(...new TextEncoder().encode(names.get(name) ?? `x${i}`), 0);
    list.push(type === UINT ? FLOAT : type, 0, 0, 0, ...rest); // of four bytes either way
  });
  list.push(0);
  const moved = list.length - size, made = new Uint8Array(bytes.length + moved);
  made.set(bytes.subarray(0, at));
  made.set(list, at);
  made.set(bytes.subarray(at + size), at + list.length);
  const view = new DataView(made.buffer);
  view.setUint32(sizeAt, list.length, true);
  if (parts.multiPart) moveChunks(view, parts, moved);
  return made.buffer;
}

function moveChunks(view, parts, moved) {
  const from = parts.tablesAt + moved, count = parts.reduce((sum, part) => sum + part.chunkCount, 0);
  for (let at = from; at < from + 8 * count; at += 8) {
    view.setBigUint64(at, view.getBigUint64(at, true) + BigInt(moved), true);
  }
}
