// The mouse and the keys over the picture: what they ask the server for.

const TURN = Math.PI; // radians for a drag over the whole picture
const STEP = 0.05; // what a key does, as a part of the picture

export function follow(canvas, frame, { send, onPixel, onCrop }) {
  let drag = null;

  const place = (event) => {
    const box = canvas.getBoundingClientRect();
    return [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
  };
  const pixel = ([u, v]) => [Math.floor(u * canvas.width), Math.floor(v * canvas.height)];

  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("pointerdown", (event) => {
    canvas.focus();
    canvas.setPointerCapture(event.pointerId);
    const kind = event.ctrlKey || event.metaKey ? "crop" : event.shiftKey || event.button ? "shift" : "turn";
    drag = { kind, start: place(event), last: place(event) };
  });
  canvas.addEventListener("pointermove", (event) => {
    const now = place(event);
    onPixel(...pixel(now));
    if (!drag) return;
    const [dx, dy] = [now[0] - drag.last[0], now[1] - drag.last[1]];
    if (drag.kind === "crop") return outline(frame, canvas, drag.start, now);
    drag.last = now;
    if (dx || dy) send(drag.kind === "turn" ? turn(-dx, -dy) : shift(-dx, dy));
  });
  canvas.addEventListener("pointerup", (event) => {
    if (drag?.kind === "crop") {
      frame.hidden = true;
      const [[x, y], [right, bottom]] = [pixel(lower(drag.start, place(event))), pixel(upper(drag.start, place(event)))];
      onCrop({ x, y, width: right - x, height: bottom - y });
    }
    drag = null;
  });
  canvas.addEventListener("pointercancel", () => {
    frame.hidden = true;
    drag = null;
  });
  canvas.addEventListener("pointerleave", () => onPixel(-1, -1));
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    send({ do: "approach", factor: Math.exp(0.001 * event.deltaY) });
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const message = {
      ArrowLeft: turn(STEP, 0), ArrowRight: turn(-STEP, 0), ArrowUp: turn(0, STEP), ArrowDown: turn(0, -STEP),
      "+": { do: "approach", factor: 0.9 }, "-": { do: "approach", factor: 1 / 0.9 },
      0: { do: "home" }, e: { do: "show", layer: "error" }, l: { do: "show", layer: "light" },
    }[event.key];
    if (!message) return;
    event.preventDefault();
    send(message);
  });
}

const turn = (right, up) => ({ do: "turn", yaw: TURN * right, pitch: TURN * up });
const shift = (right, up) => ({ do: "shift", right, up });
const lower = (a, b) => a.map((x, i) => Math.min(x, b[i]));
const upper = (a, b) => a.map((x, i) => Math.max(x, b[i]));

function outline(frame, canvas, start, now) {
  const [[left, top], [right, bottom]] = [lower(start, now), upper(start, now)];
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  frame.hidden = false;
  frame.style.left = `${canvas.offsetLeft + left * width}px`;
  frame.style.top = `${canvas.offsetTop + top * height}px`;
  frame.style.width = `${(right - left) * width}px`;
  frame.style.height = `${(bottom - top) * height}px`;
}
