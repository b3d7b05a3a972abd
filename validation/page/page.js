"use strict";

// Pixels are stored as (value / scale) in float16, or in 255 steps from low to high.
const page = JSON.parse(document.getElementById("data").textContent);
const { width, height } = page;
const byId = (id) => document.getElementById(id);

async function inflated(text) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate-raw"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

function half(bits) {
  const sign = bits & 0x8000 ? -1 : 1;
  const exponent = (bits >> 10) & 31;
  const fraction = bits & 1023;
  return sign * (exponent ? 2 ** (exponent - 15) * (1 + fraction / 1024) : 2 ** -14 * (fraction / 1024));
}

async function numbers({ scale, data }) {
  const bytes = await inflated(data); // all lower bytes, then all higher ones
  const count = bytes.length / 2;
  const table = Float32Array.from({ length: 65536 }, (_, bits) => half(bits) * scale);
  return Float32Array.from({ length: count }, (_, i) => table[bytes[i] | (bytes[count + i] << 8)]);
}

async function steps(stored) {
  if (!stored) return null;
  const { low, high, data } = stored;
  return Float32Array.from(await inflated(data), (step) => low + (step / 254) * (high - low));
}

// ---- colours

const encoded = (x) => 255 * (x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055);

// Dark blue, green, yellow: equal steps of the logarithm, eight stops below the brightest.
const STOPS = [[13, 8, 80], [60, 50, 160], [30, 120, 180], [30, 160, 110], [150, 200, 50], [255, 240, 90], [255, 255, 255]];

function along(stops, t) {
  const place = Math.min(Math.max(t, 0), 1) * (stops.length - 1);
  const i = Math.min(Math.floor(place), stops.length - 2);
  return stops[i].map((from, k) => from + (place - i) * (stops[i + 1][k] - from));
}

const MAGMA = [[0, 0, 4], [81, 18, 124], [183, 55, 121], [252, 137, 97], [252, 253, 191]];

// White for 0, red above, blue below.
function signed(t) {
  const away = Math.min(Math.abs(t), 1);
  const hue = t > 0 ? [178, 24, 43] : [33, 102, 172];
  return hue.map((x) => 255 + (x - 255) * away);
}

function light(pixels, gain, kind) {
  return (i) => {
    const rgb = [0, 1, 2].map((k) => pixels[3 * i + k] * gain);
    if (kind === "srgb") return rgb.map((x) => encoded(Math.min(Math.max(x, 0), 1)));
    const luminance = 0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2];
    return along(STOPS, 1 + Math.log2(Math.max(luminance, 1e-30)) / 8);
  };
}

function painted(color) {
  const bitmap = document.createElement("canvas");
  bitmap.width = width;
  bitmap.height = height;
  const context = bitmap.getContext("2d");
  const picture = context.createImageData(width, height);
  for (let i = 0; i < width * height; ++i) {
    const [r, g, b] = color(i);
    picture.data.set([r, g, b, 255], 4 * i);
  }
  context.putImageData(picture, 0, 0);
  return bitmap;
}

// ---- the three pictures

const names = ["a", "b", "c"];
const canvases = names.map(byId);
const bitmaps = [null, null, null];
const view = { zoom: 1, x: 0, y: 0 }; // the upper left corner that is shown, in pixels of the images

let a, b, difference, z, flip;

const mean = (pixels, i) => (pixels[3 * i] + pixels[3 * i + 1] + pixels[3 * i + 2]) / 3;

function thirdPicture() {
  const kind = byId("third").value;
  const factor = 2 ** Number(byId("scale").value);
  byId("scale").disabled = kind === "flip";
  if (kind === "flip") return ["FLIP, 0 to 1", "1", (i) => along(MAGMA, flip[i])];
  if (kind === "z") return ["z of the worst channel", `±${(6 * factor).toPrecision(3)}`, (i) => signed(z[i] / (6 * factor))];
  if (kind === "relative") {
    const floor = 0.01 * averageOfReference;
    const relative = (i) => mean(difference, i) / (Math.abs(mean(b, i)) + floor);
    return ["difference / reference", `±${(0.1 * factor).toPrecision(3)}`, (i) => signed(relative(i) / (0.1 * factor))];
  }
  const full = page.range * factor;
  return [`red: ${page.titles[0]} is brighter`, `±${full.toPrecision(3)}`, (i) => signed(mean(difference, i) / full)];
}

let averageOfReference = 0;

function paintImages() {
  const exposure = Number(byId("exposure").value);
  byId("stops").textContent = exposure.toFixed(1);
  const kind = byId("colours").value;
  bitmaps[0] = painted(light(a, 2 ** exposure, kind));
  bitmaps[1] = painted(light(b, 2 ** exposure, kind));
}

function paintThird() {
  const [title, full, color] = thirdPicture();
  byId("title-c").textContent = title;
  byId("full").textContent = full;
  bitmaps[2] = painted(color);
}

function draw() {
  canvases.forEach((canvas, k) => {
    const context = canvas.getContext("2d");
    context.imageSmoothingEnabled = false;
    context.fillStyle = "#808080";
    context.fillRect(0, 0, canvas.width, canvas.height);
    const size = (canvas.width / width) * view.zoom;
    context.drawImage(bitmaps[k], -view.x * size, -view.y * size, width * size, height * size);
  });
}

// Canvases have the pixels of the screen, and the shape of the images.
function fit() {
  for (const canvas of canvases) {
    canvas.width = Math.max(1, Math.round(canvas.clientWidth * devicePixelRatio));
    canvas.height = Math.max(1, Math.round((canvas.width * height) / width));
  }
  draw();
}

// The place below the pointer, in pixels of the images.
function below(event) {
  const box = event.currentTarget.getBoundingClientRect();
  const size = (box.width / width) * view.zoom;
  return [view.x + (event.clientX - box.left) / size, view.y + (event.clientY - box.top) / size];
}

function keepInside() {
  view.zoom = Math.min(Math.max(view.zoom, 1), 64);
  view.x = Math.min(Math.max(view.x, 0), width - width / view.zoom);
  view.y = Math.min(Math.max(view.y, 0), height - height / view.zoom);
}

function zoomed(event) {
  event.preventDefault();
  const [x, y] = below(event);
  const before = view.zoom;
  view.zoom = Math.min(Math.max(before * 2 ** (-event.deltaY / 240), 1), 64);
  view.x = x - (x - view.x) * (before / view.zoom);
  view.y = y - (y - view.y) * (before / view.zoom);
  keepInside();
  draw();
}

function moved(event) {
  if (event.buttons & 1) {
    const size = (event.currentTarget.clientWidth / width) * view.zoom;
    view.x -= event.movementX / size;
    view.y -= event.movementY / size;
    keepInside();
    draw();
  }
  tell(...below(event));
}

function tell(x, y) {
  const [column, row] = [Math.floor(x), Math.floor(y)];
  if (column < 0 || row < 0 || column >= width || row >= height) return;
  const i = row * width + column;
  const rgb = (pixels) => Array.from(pixels.subarray(3 * i, 3 * i + 3), (v) => v.toPrecision(4)).join(" ");
  const parts = [`(${column}, ${row})`, `${page.titles[0]} ${rgb(a)}`, `${page.titles[1]} ${rgb(b)}`];
  parts.push(`difference ${rgb(difference)}`);
  if (z) parts.push(`z ${z[i].toFixed(2)}`);
  if (flip) parts.push(`FLIP ${flip[i].toFixed(3)}`);
  byId("pixel").textContent = parts.join("    ");
}

async function begin() {
  [a, difference, z, flip] = await Promise.all([
    numbers(page.image), numbers(page.difference), steps(page.z), steps(page.flip),
  ]);
  b = a.map((value, i) => value - difference[i]);
  averageOfReference = b.reduce((sum, value) => sum + Math.abs(value), 0) / b.length;
  for (const [name, map, title] of [["z", z, "z"], ["flip", flip, "FLIP"]]) {
    if (map) byId("third").add(new Option(title, name));
  }
  byId("title-a").textContent = page.titles[0];
  byId("title-b").textContent = page.titles[1];
  paintImages();
  paintThird();
  fit();
  for (const id of ["exposure", "colours"]) byId(id).addEventListener("input", () => { paintImages(); draw(); });
  for (const id of ["third", "scale"]) byId(id).addEventListener("input", () => { paintThird(); draw(); });
  byId("reset").addEventListener("click", () => { Object.assign(view, { zoom: 1, x: 0, y: 0 }); draw(); });
  for (const canvas of canvases) {
    canvas.addEventListener("wheel", zoomed, { passive: false });
    canvas.addEventListener("pointermove", moved);
    canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
  }
  addEventListener("resize", fit);
  document.body.dataset.ready = "yes";
}

begin();
