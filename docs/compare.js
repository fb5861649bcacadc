// Sliders of the gallery: two renders of a frame on top of each other, cut where the slider is.
for (const box of document.querySelectorAll(".compare")) {
  const [left, right] = box.dataset.sources.split("|").map((source) => source.split(","));
  const stage = Object.assign(document.createElement("div"), { className: "compare-stage" });
  const view = Object.assign(document.createElement("div"), { className: "compare-view" });
  const images = [right[0], left[0]].map((source) => Object.assign(new Image(), { src: source, alt: "" }));
  const cut = Object.assign(document.createElement("input"), { type: "range", min: 0, max: 100, value: 50 });
  cut.setAttribute("aria-label", "Where the left picture ends");
  const move = () => { images[1].style.clipPath = `inset(0 ${100 - cut.value}% 0 0)`; };
  cut.addEventListener("input", move);
  const bar = document.createElement("p");
  const button = (text, act) => {
    const made = Object.assign(document.createElement("button"), { type: "button", textContent: text });
    made.addEventListener("click", act);
    bar.append(made, " ");
    return made;
  };
  const shown = left.map((source, index) => button(box.dataset.names.split(",")[index], () => show(index)));
  const show = (index) => {
    images[1].src = left[index];
    shown.forEach((one, at) => one.setAttribute("aria-pressed", at === index));
  };
  for (const zoom of [1, 2]) {
    button(`${100 * zoom} %`, () => {
      for (const image of images) image.style.width = `${zoom * image.naturalWidth}px`;
    });
  }
  view.append(...images);
  stage.append(view);
  box.replaceChildren(stage, cut, bar);
  move();
  show(0);
}
