// The scene's parameters as sliders, colours and numbers.

export function build(parent, controls, send) {
  parent.replaceChildren(...controls.map((control) => {
    const label = document.createElement("label");
    label.dataset.key = control.key;
    const name = document.createElement("span");
    name.className = "name";
    name.textContent = control.key;
    const row = document.createElement("span");
    row.className = "row";
    const set = (value) => send({ do: "set", key: control.key, value });
    row.append(...{ number: numberInputs, colour: colourInputs, point: pointInputs }[control.kind](control, set));
    label.append(name, row);
    return label;
  }));
}

function input(type, value, attributes = {}) {
  const element = Object.assign(document.createElement("input"), { type, ...attributes });
  element.value = value;
  return element;
}

const rounded = (value) => Number(value.toPrecision(4));

function numberInputs({ key, value: [value], low, high }, set) {
  const slider = input("range", value, { min: low, max: high, step: (high - low) / 200 });
  const field = input("number", rounded(value), { step: "any" });
  slider.value = value; // once its range is known
  slider.setAttribute("aria-label", key);
  slider.oninput = () => {
    field.value = rounded(slider.valueAsNumber);
    set([slider.valueAsNumber]);
  };
  field.onchange = () => {
    slider.value = field.value;
    set([field.valueAsNumber]);
  };
  return [slider, field];
}

// A colour of any brightness: what the picker can show, times a factor that is 1 for colours up to white.
function colourInputs({ key, value }, set) {
  const brightness = Math.max(1, ...value);
  const picker = input("color", hex(value.map((x) => x / brightness)));
  const factor = input("number", rounded(brightness), { min: 0, step: "any", title: "factor" });
  picker.setAttribute("aria-label", key);
  const changed = () => set(light(picker.value).map((x) => x * factor.valueAsNumber));
  picker.oninput = changed;
  factor.onchange = changed;
  return [picker, factor];
}

function pointInputs({ value }, set) {
  const fields = value.map((x) => input("number", rounded(x), { step: "any" }));
  for (const field of fields) field.onchange = () => set(fields.map((each) => each.valueAsNumber));
  return fields;
}

const encode = (x) => (x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055);
const decode = (x) => (x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4);
const clip = (x) => Math.min(Math.max(x, 0), 1);

function hex(linear) {
  return `#${linear.map((x) => Math.round(255 * encode(clip(x))).toString(16).padStart(2, "0")).join("")}`;
}

function light(text) {
  return [1, 3, 5].map((i) => decode(parseInt(text.slice(i, i + 2), 16) / 255));
}
