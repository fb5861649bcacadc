// Curves over the frames.
const CHART = { width: 560, height: 190, left: 56, right: 552, top: 10, bottom: 164 };

function ticks(low, high) {
  const rough = (high - low) / 4, power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 5, 10].find(factor => factor * power >= rough);
  const first = Math.ceil(low / step), count = Math.floor(high / step) - first + 1;
  return Array.from({ length: count }, (_, i) => Number(((first + i) * step).toPrecision(12)));
}

// Of the axis: from 0 where that is near, and not so little that nothing looks like much.
function spanOf(values, least) {
  const low = Math.min(...values), high = Math.max(...values);
  if (low >= 0 && low < Math.max(high - low, least)) return { low: 0, high: Math.max(1.08 * high, least) };
  const half = Math.max(1.16 * (high - low), least) / 2, middle = (low + high) / 2;
  return { low: middle - half, high: middle + half };
}

function drawChart(chart, place) {
  const box = element("div", place, undefined, "chart");
  element("h3", box, chart.title);
  const values = Object.values(chart.curves).flat().filter(value => value !== null);
  const span = spanOf(values, chart.span);
  const count = data.numbers.length;
  const x = index => CHART.left + (count > 1 ? index / (count - 1) : 0.5) * (CHART.right - CHART.left);
  const y = value => CHART.bottom - (value - span.low) / (span.high - span.low) * (CHART.bottom - CHART.top);
  const root = svg("svg", { viewBox: `0 0 ${CHART.width} ${CHART.height}`, role: "img", "aria-label": chart.title }, box);
  drawAxes(root, span, x, y);
  for (const [name, curve] of Object.entries(chart.curves)) drawCurve(root, name, curve, x, y);
  const legend = element("p", box, undefined, "figures"), here = svg("line", { class: "here" }, root);
  const tell = index => drawLegend(legend, chart, index);
  tell(null);
  root.addEventListener("pointermove", event => {
    const at = new DOMPoint(event.clientX, event.clientY).matrixTransform(root.getScreenCTM().inverse()).x;
    const share = (at - CHART.left) / (CHART.right - CHART.left);
    const index = Math.max(0, Math.min(count - 1, Math.round(share * (count - 1))));
    for (const [end, at] of [["x1", x(index)], ["x2", x(index)], ["y1", CHART.top], ["y2", CHART.bottom]]) here.setAttribute(end, at);
    tell(index);
  });
  element("p", box, chart.note, "note");
}

function drawAxes(root, span, x, y) {
  for (const tick of ticks(span.low, span.high)) {
    svg("line", { class: "grid", x1: CHART.left, x2: CHART.right, y1: y(tick), y2: y(tick) }, root);
    svg("text", { class: "axis", x: CHART.left - 6, y: y(tick) + 4, "text-anchor": "end" }, root, String(tick));
  }
  const every = Math.ceil(data.numbers.length / 10);
  for (const [index, number] of data.numbers.entries()) {
    if (index % every === 0)
      svg("text", { class: "axis", x: x(index), y: CHART.bottom + 16, "text-anchor": "middle" }, root, String(number));
    if (index && data.cuts.includes(number)) {
      const cut = svg("line", { class: "cut", x1: x(index), x2: x(index), y1: CHART.top, y2: CHART.bottom }, root);
      svg("title", {}, cut, `a shot begins at frame ${number}`);
    }
  }
}

// What a curve is of, as classes: 'after', and of views but the first one 'other'.
function classesOf(name) {
  const [of, ...view] = name.split(" ");
  return Object.keys(data.views).indexOf(view.join(" ")) > 0 ? `${of} other` : of;
}

// A line through neighbours that both have a value; a dot where there is no neighbour, or there are few frames.
function drawCurve(root, name, values, x, y) {
  const group = svg("g", { class: classesOf(name), "data-curve": name }, root);
  const path = values.map((value, i) => value === null ? "" : `${i && values[i - 1] !== null ? "L" : "M"}${x(i)},${y(value)}`);
  svg("path", { class: "curve", d: path.join("") }, group);
  const few = values.length <= 60;
  for (const [i, value] of values.entries())
    if (value !== null && (few || (values[i - 1] ?? null) === null && (values[i + 1] ?? null) === null))
      svg("circle", { class: "dot", cx: x(i), cy: y(value), r: 3 }, group);
}

function drawLegend(place, chart, index) {
  place.replaceChildren();
  for (const [name, values] of Object.entries(chart.curves)) {
    element("span", place, undefined, `key ${classesOf(name)}`);
    const value = index === null ? undefined : values[index];
    place.append(value === undefined ? name : `${name} ${value === null ? "none" : value.toPrecision(4)}`);
  }
  if (index !== null) place.append(`, frame ${data.numbers[index]}`);
}
