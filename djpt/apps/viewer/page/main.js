// The page: puts the connection, the picture, the pointer and the controls together.

import { connect } from "./connection.js";
import { build } from "./controls.js";
import { Picture } from "./picture.js";
import { follow } from "./pointer.js";

const part = (id) => document.getElementById(id);
const canvas = part("picture");
const picture = new Picture(canvas);
let paused = false;
let under = [-1, -1];
let newest = null;
const looks = {}; // exposure and curve of each layer
const asked = new Map(); // when messages were sent, by their numbers

const connection = connect({
  onState: (text) => (part("status").textContent = text),
  onMessage: (message) => {
    if (message.error) return complain(message.error);
    complain(message.problem);
    picture.constants = message.tone;
    part("layer").replaceChildren(...message.layers.map((name) => new Option(name)));
    part("layer").value = message.layer;
    showPaused(message.paused);
    build(part("controls"), message.controls, send);
    filter();
  },
  onFrame: (frame) => {
    newest = frame;
    picture.take(frame);
    recallLook(frame.layer);
    draw();
    report(frame);
  },
});

function send(message) {
  complain("");
  const number = connection.send(message);
  asked.set(number, performance.now());
  return number;
}

// Numbers that aren't light are fitted to what is seen, until somebody chooses an exposure.
function recallLook(layer) {
  const curve = { light: "srgb", albedo: "srgb", error: "heat" }[layer] ?? "linear";
  const fits = ["error", "depth", "position", "shape"].includes(layer);
  const look = (looks[layer] ??= { exposure: 0, curve, fits });
  if (look.fits) look.exposure = picture.fittingExposure();
  part("exposure").value = look.exposure;
  part("curve").value = look.curve;
  part("stops").textContent = part("exposure").value;
}

function changeLook() {
  part("stops").textContent = part("exposure").value;
  if (newest) looks[newest.layer] = { exposure: part("exposure").valueAsNumber, curve: part("curve").value };
  draw();
}

function draw() {
  if (!newest) return;
  picture.draw(part("exposure").valueAsNumber, part("curve").value);
  showPixel();
}

function report({ spp, goal, error, seconds, layer, answer, window: [x, y, width, height], size }) {
  const parts = [`${size[0]} x ${size[1]}`, `${spp} of ${goal} spp`, `${seconds.toFixed(1)} s`];
  if (error) parts.push(`error ${(100 * error).toPrecision(2)} %`);
  part("status").textContent = parts.join(", ");
  part("layer").value = layer;
  part("whole").disabled = width === size[0] && height === size[1];
  if (asked.has(answer)) {
    document.body.dataset.delay = Math.round(performance.now() - asked.get(answer));
    for (const number of [...asked.keys()]) if (number <= answer) asked.delete(number);
  }
  Object.assign(document.body.dataset, { spp, answer, layer, window: [x, y, width, height] });
}

function complain(text) {
  part("problem").textContent = text;
  part("problem").hidden = !text;
}

function showPixel() {
  const rgb = picture.pixel(...under);
  part("pixel").textContent = rgb ? `(${under.join(", ")}): ${rgb.map((x) => x.toPrecision(3)).join("  ")}` : "\u00a0";
}

function showPaused(now) {
  paused = now;
  part("pause").textContent = paused ? "continue" : "pause";
}

function pause() {
  showPaused(!paused);
  send({ do: "pause", paused });
}

function filter() {
  const text = part("filter").value.toLowerCase();
  for (const row of part("controls").children) row.hidden = !row.dataset.key.toLowerCase().includes(text);
}

function zoom() {
  const factor = Number(part("zoom").value);
  canvas.className = factor ? "" : "fit";
  canvas.style.width = factor ? `${factor * canvas.width}px` : "";
}

follow(canvas, part("window"), {
  send,
  onPixel: (column, row) => {
    under = [column, row];
    showPixel();
  },
  onCrop: (box) => send({ do: "crop", ...box }),
});

part("layer").onchange = () => send({ do: "show", layer: part("layer").value });
part("curve").onchange = changeLook;
part("exposure").oninput = changeLook;
part("fitting").onclick = () => {
  part("exposure").value = picture.fittingExposure();
  changeLook();
};
part("zoom").onchange = zoom;
part("filter").oninput = filter;
part("pause").onclick = pause;
part("home").onclick = () => send({ do: "home" });
part("whole").onclick = () => send({ do: "crop", x: 0, y: 0, width: 0, height: 0 });
part("save").onclick = () => {
  const link = document.createElement("a");
  link.download = "view.png";
  link.href = canvas.toDataURL("image/png");
  link.click();
};
document.addEventListener("keydown", (event) => {
  if (event.key === " " && event.target === canvas) {
    event.preventDefault();
    pause();
  }
});
zoom();
