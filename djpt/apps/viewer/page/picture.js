// Draws frames by WebGL: exposure, tone curve and the curve of sRGB are computed for each pixel of the display.

const CURVES = ["srgb", "reinhard", "aces", "agx", "linear", "heat"];

const VERTEX = `#version 300 es
out vec2 place;
void main() {
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1);
  place = vec2(corner.x, 1.0 - corner.y);
  gl_Position = vec4(2.0 * corner - 1.0, 0.0, 1.0);
}`;

const FRAGMENT = `#version 300 es
precision highp float;
uniform sampler2D light;
uniform float gain;
uniform int curve;
uniform mat3 acesIn, acesOut, agxIn, agxOut;
uniform float agxCurve[7];
uniform vec2 agxStops;
in vec2 place;
out vec4 shown;

vec3 reinhard(vec3 rgb) {
  float luminance = dot(rgb, vec3(0.212671, 0.715160, 0.072169));
  return rgb / (1.0 + luminance);
}
vec3 aces(vec3 rgb) {
  vec3 x = acesIn * rgb;
  vec3 y = (x * (x + 0.0245786) - 0.000090537) / (x * (0.983729 * x + 0.4329510) + 0.238081);
  return acesOut * max(y, 0.0);
}
vec3 agx(vec3 rgb) {
  vec3 x = clamp((log2(max(agxIn * rgb, exp2(agxStops.x))) - agxStops.x) / (agxStops.y - agxStops.x), 0.0, 1.0);
  vec3 y = vec3(0.0);
  for (int i = 0; i < 7; ++i) y = y * x + agxCurve[i];
  return pow(max(agxOut * max(y, 0.0), 0.0), vec3(2.2));
}
vec3 heat(vec3 rgb) { // black, red, yellow, white
  float x = 3.0 * rgb.g;
  return clamp(vec3(x, x - 1.0, x - 2.0), 0.0, 1.0);
}
vec3 encoded(vec3 rgb) {
  return mix(12.92 * rgb, 1.055 * pow(rgb, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, rgb));
}
void main() {
  vec3 rgb = min(max(texture(light, place).rgb, 0.0) * gain, 1e9);
  if (curve == 1) rgb = reinhard(rgb);
  else if (curve == 2) rgb = aces(rgb);
  else if (curve == 3) rgb = agx(rgb);
  if (curve == 5) shown = vec4(heat(rgb), 1.0);
  else {
    rgb = clamp(rgb, 0.0, 1.0);
    shown = vec4(curve == 4 ? rgb : encoded(rgb), 1.0);
  }
}`;

export class Picture {
  constructor(canvas) {
    this.canvas = canvas;
    // Kept between frames, so that the picture can be saved and read.
    const gl = (this.gl = canvas.getContext("webgl2", { alpha: false, antialias: false, preserveDrawingBuffer: true }));
    if (!gl) throw new Error("this browser has no WebGL 2");
    const program = linked(gl);
    gl.useProgram(program);
    this.uniform = (name) => gl.getUniformLocation(program, name);
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    for (const side of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, side, gl.NEAREST);
    for (const axis of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, axis, gl.CLAMP_TO_EDGE);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 2);
    this.halves = new Uint16Array(0);
    this.size = [0, 0];
  }

  set constants({ aces_in, aces_out, agx_in, agx_out, agx_curve, agx_stops }) {
    const { gl, uniform } = this;
    const matrices = { acesIn: aces_in, acesOut: aces_out, agxIn: agx_in, agxOut: agx_out };
    for (const [name, rows] of Object.entries(matrices)) gl.uniformMatrix3fv(uniform(name), true, rows.flat());
    gl.uniform1fv(uniform("agxCurve"), agx_curve);
    gl.uniform2fv(uniform("agxStops"), agx_stops);
  }

  // A frame may cover only a window of the picture; the rest keeps what it had.
  take({ size, window: [x, y, width, height], halves }) {
    const { gl } = this;
    const [columns, rows] = size;
    if (columns !== this.size[0] || rows !== this.size[1]) {
      this.size = [columns, rows];
      this.halves = new Uint16Array(3 * columns * rows);
      this.canvas.width = columns;
      this.canvas.height = rows;
      gl.viewport(0, 0, columns, rows);
    }
    for (let row = 0; row < height; ++row) {
      const line = halves.subarray(3 * row * width, 3 * (row + 1) * width);
      this.halves.set(line, 3 * ((y + row) * columns + x));
    }
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB16F, columns, rows, 0, gl.RGB, gl.HALF_FLOAT, this.halves);
  }

  draw(exposure, curve) {
    const { gl, uniform } = this;
    gl.uniform1f(uniform("gain"), 2 ** exposure);
    gl.uniform1i(uniform("curve"), CURVES.indexOf(curve));
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
  }

  // The exposure at which all but one of a hundred pixels are below 1.
  fittingExposure() {
    const stride = Math.max(1, Math.floor(this.halves.length / 20000));
    const sampled = [];
    for (let i = 0; i < this.halves.length; i += stride) sampled.push(number(this.halves[i]));
    const positive = sampled.filter((x) => x > 0 && x < Infinity).sort((a, b) => a - b);
    return positive.length ? -Math.log2(positive[Math.floor(0.99 * (positive.length - 1))]) : 0;
  }

  pixel(column, row) {
    const [columns, rows] = this.size;
    if (column < 0 || row < 0 || column >= columns || row >= rows) return null;
    const start = 3 * (row * columns + column);
    return Array.from(this.halves.subarray(start, start + 3), number);
  }
}

// The value of a float16 with these bits.
function number(bits) {
  const sign = bits & 0x8000 ? -1 : 1;
  const exponent = (bits >> 10) & 31;
  const fraction = bits & 1023;
  if (exponent === 31) return fraction ? NaN : sign * Infinity;
  return sign * (exponent ? 2 ** (exponent - 15) * (1 + fraction / 1024) : 2 ** -14 * (fraction / 1024));
}

function linked(gl) {
  const program = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
  return program;
}
