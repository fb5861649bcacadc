// Light as postfx/tools/report/pictures.py packs it: codes that any exposure can be made of.
const LARGEST = 511;

// Red, green and blue codes of each pixel in turn.
async function unpack(picture) {
  const bytes = Uint8Array.from(atob(picture.data), letter => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const content = new Uint8Array(await new Response(stream).arrayBuffer());
  const { width, height } = picture, size = width * height, codes = new Uint16Array(3 * size);
  for (const [plane, channel] of [1, 0, 2].entries()) {
    for (let i = 0, value = 0; i < size; i++) {
      if (i % width === 0) value = 0;
      const at = plane * size + i, folded = content[at] | content[3 * size + at] << 8;
      value += folded & 1 ? -(folded + 1 >> 1) : folded >> 1;
      codes[3 * i + channel] = plane ? value + codes[3 * i + 1] : value;
    }
  }
  return codes;
}

// Linear light of a code, exposed as the run exposed it.
function lightOf(code, { toe, highest }) {
  return toe * ((1 + highest / toe) ** (code / LARGEST) - 1);
}

// 8 bits of the screen for each code; scene-linear light is compressed by x / (1 + x), a display's is clipped.
function screenOf(picture, ev, display) {
  const table = new Uint8ClampedArray(LARGEST + 1);
  for (let code = 0; code <= LARGEST; code++) {
    const light = lightOf(code, picture) * 2 ** ev;
    const seen = display ? Math.min(light, 1) : light / (1 + light);
    table[code] = 255 * (seen <= 0.0031308 ? 12.92 * seen : 1.055 * seen ** (1 / 2.4) - 0.055);
  }
  return table;
}

function paint(canvas, codes, picture, ev, display) {
  canvas.width = picture.width;
  canvas.height = picture.height;
  const table = screenOf(picture, ev, display), context = canvas.getContext("2d");
  const image = context.createImageData(picture.width, picture.height), pixels = image.data;
  for (let i = 0, j = 0; i < codes.length; i += 3, j += 4) {
    pixels[j] = table[codes[i]];
    pixels[j + 1] = table[codes[i + 1]];
    pixels[j + 2] = table[codes[i + 2]];
    pixels[j + 3] = 255;
  }
  context.putImageData(image, 0, 0);
}
