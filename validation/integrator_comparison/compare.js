"use strict";
// A picture on the left of a line that can be moved; on its right the reference, or the map of errors.
const dialog = document.getElementById("compare");
const cards = [...document.querySelectorAll(".cards.pictures button")];
const [stack, slider, title] = [".stack", "input", "strong"].map((part) => dialog.querySelector(part));
const choices = [...dialog.querySelectorAll(".choice button")];
let current = 0, other = "reference";

const picture = (source) => Object.assign(new Image(), { src: source.src, alt: source.alt, draggable: false });
const split = (percent) => { slider.value = percent; stack.style.setProperty("--split", percent + "%"); };

function show(number) {
  current = (number + cards.length) % cards.length;
  const image = cards[current].querySelector("img");
  const errors = document.getElementById("errors-" + image.dataset.step);
  const right = other === "errors" && errors ? errors : document.getElementById("reference");
  stack.replaceChildren(picture(image), picture(right));
  stack.style.setProperty("--aspect", image.naturalWidth / image.naturalHeight);
  title.textContent = image.dataset.title + " | " + (right === errors ? "error" : "reference");
  for (const choice of choices) choice.setAttribute("aria-pressed", String(choice.value === other));
}

cards.forEach((card, number) => card.addEventListener("click", () => { show(number); split(50); dialog.showModal(); }));
for (const choice of choices) choice.addEventListener("click", () => { other = choice.value; show(current); });
slider.addEventListener("input", () => split(slider.value));
for (const kind of ["pointerdown", "pointermove"]) {
  stack.addEventListener(kind, (event) => {
    if (!event.buttons) return;
    const box = stack.getBoundingClientRect();
    split(Math.min(Math.max((100 * (event.clientX - box.left)) / box.width, 0), 100));
  });
}
dialog.querySelector("[value=previous]").addEventListener("click", () => show(current - 1));
dialog.querySelector("[value=next]").addEventListener("click", () => show(current + 1));
dialog.addEventListener("click", (event) => { if (event.target === dialog) dialog.close(); });
