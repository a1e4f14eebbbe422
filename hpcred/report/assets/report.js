"use strict";
// Arrays come as base64 of little-endian numbers: {dtype, shape, bdata}.
const KINDS = { f4: Float32Array, f8: Float64Array, u4: Uint32Array, i2: Int16Array };
function numbers(packed) {
  const text = atob(packed.bdata), bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  return new KINDS[packed.dtype](bytes.buffer);
}
const data = JSON.parse(document.getElementById("data").textContent);
const CURVES = {
  light: ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00"],
  dark: ["#5ab4f0", "#ff914d", "#3fcf9f", "#e9a6cb", "#a8dcff", "#ffc857"],
};
let COLOURS;
const MORE = ["#999999", "#f0e442", "#44525a", "#8c510a", "#762a83", "#b2df8a", "#c7e9ff", "#fdbf6f"]; // of stages
const DASHES = ["solid", "dash", "dot", "dashdot"];
// the colours of the style sheet, dark where the reader has chosen so, light on paper
const dark = matchMedia("(prefers-color-scheme: dark)"), paper = matchMedia("print");
const COLOUR = {};
function takeTheme() {
  document.documentElement.dataset.theme = dark.matches && !paper.matches ? "dark" : "light";
  COLOURS = CURVES[document.documentElement.dataset.theme];
  const style = getComputedStyle(document.documentElement);
  for (const name of ["ink", "soft", "paper", "grid", "line", "band"]) COLOUR[name] = style.getPropertyValue("--" + name).trim();
}
takeTheme();
const BUTTONS = { displaylogo: false, responsive: true, modeBarButtons: [["toImage", "zoom2d", "pan2d", "autoScale2d", "resetScale2d"]] };
const axis = (title, more) => ({ title: { text: title, standoff: 8 }, automargin: true, gridcolor: COLOUR.grid, zeroline: false, linecolor: COLOUR.line, ...more });
const layout = (more) => ({
  font: { family: "system-ui, sans-serif", size: 13, color: COLOUR.ink }, margin: { l: 78, r: 20, t: 12, b: 46 },
  paper_bgcolor: COLOUR.paper, plot_bgcolor: COLOUR.paper, hovermode: "closest", legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0 }, ...more,
});
const plain = (text) => text.replace(/&/g, "&amp;").replace(/</g, "&lt;"); // Plotly takes <a> and <b> for marks
const named = (i) => plain(data.results[i].name);
const positive = (value) => (value > 0 ? value : null);
const powers = { type: "log", tickformat: ".2~e", nticks: 5 }; // 2e-5, where Plotly by itself writes 2

// ---------------------------------------------------------------- responses
function magnitude(re, im) { return Array.from(re, (x, k) => positive(Math.hypot(x, im[k]))); }
function phase(re, im) { return Array.from(re, (x, k) => (Math.atan2(im[k], x) * 180) / Math.PI); }
function broken(frequency, angle) { // no line from one end of the circle to the other
  const x = [], y = [];
  angle.forEach((value, k) => {
    if (k && Math.abs(value - angle[k - 1]) > 180) { x.push(frequency[k]); y.push(null); }
    x.push(frequency[k]); y.push(value);
  });
  return { x, y };
}
const names = [...new Set(data.results.flatMap((result) => result.pairs.map((pair) => pair.name)))];
const choice = document.getElementById("pair");
for (const name of names) choice.add(new Option(name, name));

function drawResponse() {
  const traces = [];
  let unit = "";
  data.results.forEach((result, i) => {
    const pair = result.pairs.find((item) => item.name === choice.value);
    if (!pair) return;
    unit = pair.unit;
    const line = { color: COLOURS[i % COLOURS.length], width: 1.8, dash: DASHES[i % DASHES.length] };
    const f = Array.from(numbers(result.frequencies)), re = numbers(pair.re), im = numbers(pair.im);
    traces.push({ x: f, y: magnitude(re, im), mode: "lines", name: named(i), line, legendgroup: named(i), hovertemplate: "%{x:.5g} Hz: %{y:.4g}<extra>" + named(i) + "</extra>" });
    traces.push({ ...broken(f, phase(re, im)), mode: "lines", name: named(i), line, legendgroup: named(i), showlegend: false, yaxis: "y2", hovertemplate: "%{x:.5g} Hz: %{y:.2f}°<extra>" + named(i) + "</extra>" });
    if (pair.full_re && !result.full_as_before) {
      const g = Array.from(numbers(result.full_frequencies)), fre = numbers(pair.full_re), fim = numbers(pair.full_im);
      const name = "full model" + (data.several_full ? " (" + named(i) + ")" : "");
      const marker = { color: data.several_full ? COLOURS[i % COLOURS.length] : COLOUR.ink, size: 7, symbol: "circle-open", line: { width: 1.5 } };
      traces.push({ x: g, y: magnitude(fre, fim), mode: "markers", name, marker, legendgroup: name, hovertemplate: "%{x:.5g} Hz: %{y:.4g}<extra>full</extra>" });
      traces.push({ x: g, y: phase(fre, fim), mode: "markers", name, marker, legendgroup: name, showlegend: false, yaxis: "y2", hovertemplate: "%{x:.5g} Hz: %{y:.2f}°<extra>full</extra>" });
    }
  });
  const type = document.getElementById("logf").checked ? "log" : "linear";
  return Plotly.react("response", traces, layout({
    xaxis: axis("frequency (Hz)", { type, anchor: "y2" }), yaxis: axis(`|H| (${unit})`, { ...powers, domain: [0.4, 1] }),
    yaxis2: axis("phase (degrees)", { domain: [0, 0.33], range: [-190, 190], tickvals: [-180, -90, 0, 90, 180] }),
  }), BUTTONS);
}
choice.addEventListener("change", drawResponse);
document.getElementById("logf").addEventListener("change", drawResponse);

// ---------------------------------------------------------------- error, points, spectrum, effort
function drawErrors() {
  const traces = [], shapes = [];
  data.results.forEach((result, i) => {
    const colour = COLOURS[i % COLOURS.length], group = named(i);
    if (result.eps) traces.push({ x: Array.from(numbers(result.eps_frequencies)), y: Array.from(numbers(result.eps), positive), mode: "lines", name: group + ": estimate", line: { color: colour, width: 1.4, dash: DASHES[i % DASHES.length] } });
    if (result.measured_eps) traces.push({ x: Array.from(numbers(result.full_frequencies)), y: Array.from(numbers(result.measured_eps), positive), mode: "markers", name: group + ": measured", marker: { color: colour, size: 8, symbol: "circle-open", line: { width: 1.6 } } });
    if (result.tolerance) shapes.push({ type: "line", xref: "paper", x0: 0, x1: 1, y0: result.tolerance, y1: result.tolerance, line: { color: colour, width: 1, dash: "dash" } });
  });
  const words = traces.length ? [] : [{ text: "Not known: the basis was chosen by hand. --full MODEL.h5 compares with the full model.", showarrow: false, xref: "paper", yref: "paper", x: 0.5, y: 0.5 }];
  return Plotly.react("error", traces, layout({ shapes, annotations: words, showlegend: true, xaxis: axis("frequency (Hz)"), yaxis: axis("relative error eps", powers) }), BUTTONS);
}
function drawPoints() {
  if (!document.getElementById("points")) return null;
  const traces = [], shapes = [];
  data.results.forEach((result, i) => {
    if (!result.points.length) return;
    const colour = COLOURS[i % COLOURS.length];
    traces.push({ x: result.points.map((_, k) => k + 1), y: result.points.map((point) => positive(point.estimate)), text: result.points.map((point) => point.frequency.toPrecision(5) + " Hz"), mode: "lines+markers+text", textposition: "top center", textfont: { size: 11 }, name: named(i), line: { color: colour }, marker: { size: 8 }, cliponaxis: false, connectgaps: true });
    if (result.tolerance) shapes.push({ type: "line", xref: "paper", x0: 0, x1: 1, y0: result.tolerance, y1: result.tolerance, line: { color: colour, width: 1, dash: "dash" } });
  });
  return Plotly.react("points", traces, layout({ shapes, showlegend: true, xaxis: axis("expansion points", { dtick: 1 }), yaxis: axis("largest estimate over the band", powers) }), BUTTONS);
}
function drawSpectrum() {
  const traces = [];
  const row = (x, y, colour) => ({ x, y: x.map(() => y), mode: "markers", name: y, showlegend: false, marker: { symbol: "line-ns-open", size: 22, color: colour, line: { width: 2, color: colour } }, hovertemplate: "%{x:.6g} Hz<extra></extra>" });
  const modes = data.results.find((result) => result.modes);
  if (modes) traces.push(row(Array.from(numbers(modes.modes)), "modes of the model", COLOUR.ink));
  data.results.forEach((result, i) => traces.unshift(row(Array.from(numbers(result.pseudo)), named(i), COLOURS[i % COLOURS.length])));
  const top = data.band ? 1.6 * data.band[1] : undefined;
  const shapes = data.band ? [{ type: "rect", x0: data.band[0], x1: data.band[1], yref: "paper", y0: 0, y1: 1, fillcolor: COLOUR.band, line: { width: 0 }, layer: "below" }] : [];
  return Plotly.react("spectrum", traces, layout({ shapes, margin: { l: 160, r: 20, t: 12, b: 46 }, xaxis: axis("frequency (Hz), band grey", top ? { range: [0, top] } : {}), yaxis: axis("", { type: "category", automargin: true }) }), BUTTONS);
}
function drawStages() {
  const longest = (stage) => Math.max(...data.results.map((result) => result.seconds[stage] || 0));
  const stages = [...new Set(data.results.flatMap((result) => Object.keys(result.seconds)))].sort((a, b) => longest(b) - longest(a));
  const traces = stages.map((stage, k) => ({ type: "bar", orientation: "h", name: plain(stage), y: data.results.map((_, i) => named(i)), x: data.results.map((result) => result.seconds[stage] || 0), marker: { color: [...COLOURS, ...MORE][k % 14] }, hovertemplate: plain(stage) + " %{x:.3g} s<extra></extra>" }));
  return Plotly.react("stages", traces, layout({ barmode: "stack", margin: { l: 160, r: 20, t: 30, b: 46 }, legend: { orientation: "h", y: -0.25, yanchor: "top", x: 0, traceorder: "normal" }, xaxis: axis("", { ticksuffix: " s" }), yaxis: axis("", { type: "category", automargin: true, autorange: "reversed" }) }), BUTTONS);
}

// ---------------------------------------------------------------- bodies
const VERTEX = `
attribute vec3 displacement; attribute float value;
uniform float amplitude; uniform float fade; uniform float point;
varying float size; varying float known; varying vec3 place;
void main() {
  size = value * fade;
  known = value < 0.0 ? 0.0 : 1.0;
  vec4 seen = modelViewMatrix * vec4(position + amplitude * SWING * displacement, 1.0);
  place = seen.xyz;
  gl_PointSize = point;
  gl_Position = projectionMatrix * seen;
}`;
const stop = (text) => "vec3(" + [1, 3, 5].map((k) => (parseInt(text.slice(k, k + 2), 16) / 255).toFixed(3)).join(", ") + ")";
const COLOURED = `
varying float size; varying float known; varying vec3 place;
const vec3 stops[${data.stops.length}] = vec3[${data.stops.length}](${data.stops.map(stop).join(", ")});
vec3 coloured(float t) {
  if (known < 0.999) return vec3(0.4);
  t = ${data.stops.length - 1}.0 * clamp(t, 0.0, 1.0);
  int k = min(int(t), ${data.stops.length - 2});
  return mix(stops[k], stops[k + 1], t - float(k));
}`;
const SURFACE = COLOURED + `
void main() {
  vec3 normal = normalize(cross(dFdx(place), dFdy(place)));
  if (normal.z < 0.0) normal = -normal;
  float light = 0.55 + 0.45 * max(dot(normal, normalize(vec3(-0.35, 0.45, 0.82))), 0.0);
  gl_FragColor = vec4(coloured(size) * light, 1.0);
}`;
const DOTS = COLOURED + `
void main() {
  float r = length(gl_PointCoord - 0.5);
  if (r > 0.5) discard;
  gl_FragColor = vec4(coloured(size) * (1.0 - 1.4 * r * r), 1.0);
}`;
const MARKS = `
void main() {
  float r = length(gl_PointCoord - 0.5);
  if (r > 0.5) discard;
  gl_FragColor = r > 0.38 ? vec4(1.0) : vec4(0.835, 0.369, 0.0, 1.0);
}`;
const PLAIN = `
uniform vec3 colour;
void main() { gl_FragColor = vec4(colour, 1.0); }`;

class BodyView {
  constructor(element, shape) {
    this.element = element; this.shape = shape; this.mode = shape.start; this.phase = 1;
    this.renderer = new THREE.WebGLRenderer({ alpha: true, antialias: true, preserveDrawingBuffer: true });
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    this.renderer.setClearColor(0, 0); // what is behind has the colour of the style sheet
    element.appendChild(this.renderer.domElement);
    this.scene = new THREE.Scene();
    this.place = new THREE.BufferAttribute(numbers(shape.points), 3);
    const attribute = (packed, width) => new THREE.BufferAttribute(numbers(packed), width, packed.dtype === "i2");
    this.fields = shape.fields.map((field) => attribute(field, 3));
    this.stresses = shape.stresses.map((values) => attribute(values, 1));
    this.moves = Boolean(shape.times); this.colour = this.moves ? "stress" : "displacement";
    this.amplitude = { value: 1 }; this.still = { value: 0 }; this.fade = { value: 1 };
    this.geometries = [];
    this.build();
    this.frame();
    new ResizeObserver(() => this.resize()).observe(element);
    this.resize();
    this.show(this.mode);
  }
  geometry(index) {
    const made = new THREE.BufferGeometry();
    made.setAttribute("position", this.place);
    if (index) made.setIndex(new THREE.BufferAttribute(numbers(index), 1));
    this.geometries.push(made);
    return made;
  }
  material(fragment, amplitude, point, more) {
    const uniforms = { amplitude, fade: this.fade, point: { value: point * this.renderer.getPixelRatio() }, colour: { value: new THREE.Vector3(...(more.colour || [0, 0, 0])) } };
    delete more.colour;
    return new THREE.ShaderMaterial({ vertexShader: VERTEX.replace("SWING", this.shape.swing.toExponential(8)), fragmentShader: fragment, uniforms, ...more });
  }
  add(object) { object.frustumCulled = false; this.scene.add(object); return object; }
  build() {
    const shape = this.shape;
    if (shape.triangles.shape[0]) {
      this.add(new THREE.Mesh(this.geometry(shape.triangles), this.material(SURFACE, this.amplitude, 1, { side: THREE.DoubleSide, polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1 })));
    } else {
      this.add(new THREE.Points(this.geometry(null), this.material(DOTS, this.amplitude, 6, {})));
    }
    this.outline = this.add(new THREE.LineSegments(this.geometry(shape.outline), this.material(PLAIN, this.still, 1, { colour: [0.6, 0.6, 0.6] })));
    this.mesh = this.add(new THREE.LineSegments(this.geometry(shape.edges), this.material(PLAIN, this.amplitude, 1, { colour: [0.2, 0.2, 0.2] })));
    this.marks = this.add(new THREE.Points(this.geometry(shape.marks), this.material(MARKS, this.amplitude, 11, { depthTest: false })));
    this.marks.renderOrder = 1;
    this.mesh.visible = false;
    this.markIndex = numbers(shape.marks);
    this.tags = shape.mark_names.map((name) => this.tag("tag", name));
    this.triad = ["x", "y", "z"].map((name) => this.tag("axis", name));
    this.arrows = document.createElementNS("http://www.w3.org/2000/svg", "svg");
    this.arrows.setAttribute("class", "triad"); this.arrows.setAttribute("width", 70); this.arrows.setAttribute("height", 70);
    this.element.appendChild(this.arrows);
  }
  tag(kind, name) {
    const made = document.createElement("span");
    made.className = kind; made.textContent = name;
    this.element.appendChild(made);
    return made;
  }
  frame() {
    const p = this.place.array, low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
    for (let i = 0; i < p.length; i++) { low[i % 3] = Math.min(low[i % 3], p[i]); high[i % 3] = Math.max(high[i % 3], p[i]); }
    this.middle = new THREE.Vector3(...low.map((value, k) => (value + high[k]) / 2));
    this.radius = Math.max(Math.hypot(...low.map((value, k) => high[k] - value)) / 2, 1e-12);
    this.camera = new THREE.OrthographicCamera(-1, 1, 1, -1, 0.01 * this.radius, 40 * this.radius);
    this.camera.up.set(0, 0, 1);
    this.controls = new THREE.OrbitControls(this.camera, this.renderer.domElement);
    this.controls.addEventListener("change", () => this.draw());
    this.look("start");
  }
  look(from) {
    const towards = { start: this.shape.towards, x: [1, 0, 0], y: [0, -1, 0], z: [0, -1e-4, 1] }[from];
    this.camera.position.copy(this.middle).add(new THREE.Vector3(...towards).normalize().multiplyScalar(15 * this.radius));
    this.controls.target.copy(this.middle);
    this.camera.zoom = 1;
    this.camera.lookAt(this.middle);
    if (this.wide) this.resize(); else this.controls.update();
  }
  resize() {
    this.wide = this.element.clientWidth; this.tall = this.element.clientHeight;
    if (!this.wide || !this.tall) return;
    this.renderer.setSize(this.wide, this.tall);
    // the largest zoom at which the whole body is seen, from where it is seen now
    this.camera.updateMatrixWorld();
    const p = this.place.array, v = new THREE.Vector3(), most = [0, 0], step = 3 * Math.max(1, Math.floor(p.length / 60000));
    for (let i = 0; i + 2 < p.length; i += step) {
      v.set(p[i], p[i + 1], p[i + 2]).applyMatrix4(this.camera.matrixWorldInverse);
      most[0] = Math.max(most[0], Math.abs(v.x)); most[1] = Math.max(most[1], Math.abs(v.y));
    }
    const room = 1.1, swing = this.shape.swing;
    const half = Math.max((most[1] + swing) * room, ((most[0] + swing) * room * this.tall) / this.wide);
    Object.assign(this.camera, { left: (-half * this.wide) / this.tall, right: (half * this.wide) / this.tall, top: half, bottom: -half });
    this.camera.updateProjectionMatrix();
    this.controls.update();
    this.draw();
  }
  show(mode) {
    this.mode = mode;
    for (const geometry of this.geometries) {
      geometry.setAttribute("displacement", this.fields[mode]);
      geometry.setAttribute("value", this.valuesOf(mode));
    }
    this.draw();
  }
  valuesOf(mode) { // of the colour, relative to the largest
    if (this.colour === "stress" && this.stresses.length) return this.stresses[mode];
    const field = this.fields[mode], values = new Float32Array(field.count);
    for (let i = 0; i < values.length; i++) values[i] = Math.hypot(field.getX(i), field.getY(i), field.getZ(i));
    return new THREE.BufferAttribute(values, 1);
  }
  draw() { // once, however much has changed until the next frame
    this.waiting ??= requestAnimationFrame(() => { this.waiting = null; this.paint(); });
  }
  paint() {
    this.amplitude.value = this.phase * Number(document.getElementById("amplitude").value);
    this.fade.value = this.moves ? 1 : Math.min(Math.abs(this.amplitude.value), 1);
    this.renderer.render(this.scene, this.camera);
    const v = new THREE.Vector3(), p = this.place.array, u = this.fields[this.mode], a = this.amplitude.value * this.shape.swing;
    this.tags.forEach((tag, k) => {
      const j = this.markIndex[k], i = 3 * j;
      v.set(p[i] + a * u.getX(j), p[i + 1] + a * u.getY(j), p[i + 2] + a * u.getZ(j)).project(this.camera);
      tag.style.left = `calc(${50 * (v.x + 1)}% + 8px)`; tag.style.top = `calc(${50 * (1 - v.y)}% - 18px)`; // paper has another size
      tag.style.display = this.marks.visible ? "" : "none";
    });
    let lines = "";
    this.triad.forEach((tag, k) => {
      v.set(0, 0, 0).setComponent(k, 1).transformDirection(this.camera.matrixWorldInverse);
      lines += `<line x1="35" y1="35" x2="${35 + 22 * v.x}" y2="${35 - 22 * v.y}" stroke="${COLOUR.soft}" stroke-width="1.5"/>`;
      tag.style.left = 8 + 35 + 30 * v.x - 4 + "px"; tag.style.bottom = 8 + 35 + 30 * v.y - 9 + "px";
    });
    this.arrows.innerHTML = lines;
  }
}

const MOTION = 6000; // ms that a motion takes to play
function playTimes(button, slider, choose) {
  let before = null, at = 0;
  const step = (now) => {
    if (before === null) return;
    at = (at + ((now - before) / MOTION) * slider.max) % slider.max;
    before = now;
    slider.value = 1 + Math.floor(at);
    choose();
    requestAnimationFrame(step);
  };
  button.addEventListener("click", () => {
    button.textContent = before === null ? "stop" : "play";
    if (before === null) { before = performance.now(); at = slider.value - 1; requestAnimationFrame(step); } else before = null;
  });
}
function drawStress(element) {
  const result = data.results[Number(element.dataset.result)], found = result.stress_curves, t = Array.from(numbers(found.t));
  const traces = found.curves.map((curve, i) => ({ x: t, y: Array.from(numbers(curve.y)), mode: "lines", name: plain(curve.name), line: { color: COLOURS[i % COLOURS.length], width: 1.5, dash: DASHES[i % DASHES.length] }, hovertemplate: "%{x:.4g} s: %{y:.4g} MPa<extra>" + plain(curve.name) + "</extra>" }));
  const at = element.dataset.at ?? result.motion.times[result.motion.start];
  return Plotly.react(element, traces, layout({ shapes: [timeLine(at)], showlegend: true, xaxis: axis("time (s)"), yaxis: axis("von Mises stress (MPa)", { rangemode: "tozero" }) }), BUTTONS);
}
const timeLine = (at) => ({ type: "line", x0: at, x1: at, yref: "paper", y0: 0, y1: 1, line: { color: COLOUR.soft, width: 1 } });
function markTime(view, at) {
  const plot = view.parentNode.querySelector(".stress-curves");
  plot.dataset.at = at;
  if (plot.data) Plotly.relayout(plot, { shapes: [timeLine(at)] });
}

const views = [];
function drawBodies() {
  document.querySelectorAll(".view").forEach((element) => {
    const result = data.results[Number(element.dataset.result)], slider = element.parentNode.querySelector(".mode");
    const told = element.parentNode.querySelector(".frequency");
    const moves = "motion" in element.dataset, shape = moves ? result.motion : result.shape;
    let view;
    try {
      view = new BodyView(element, shape);
    } catch (error) {
      element.textContent = "This browser shows no three-dimensional pictures (WebGL): " + error.message;
      return;
    }
    views.push(view);
    const choose = () => { view.show(Number(slider.value) - 1); told.textContent = shape.names[view.mode]; if (moves) markTime(element, shape.times[view.mode]); };
    slider.addEventListener("input", choose);
    const wanted = /mode=(\d+)/.exec(location.hash); // report.html#mode=3
    if (wanted && !moves) slider.value = wanted[1];
    choose();
    if (moves) playTimes(element.parentNode.querySelector(".run"), slider, choose);
  });
  const all = (change) => () => { for (const view of views) { change(view); view.draw(); } };
  const on = (id, kind, change) => { const found = document.getElementById(id); if (found) found.addEventListener(kind, () => all((view) => change(view, found))()); };
  on("outline", "change", (view, box) => { view.outline.visible = box.checked; });
  on("mesh", "change", (view, box) => { view.mesh.visible = box.checked; });
  on("interface", "change", (view, box) => { view.marks.visible = box.checked; });
  on("amplitude", "input", () => {});
  on("colour", "change", (view, list) => { if (!view.moves) { view.colour = list.value; view.show(view.mode); } });
  document.querySelectorAll("[data-view]").forEach((button) => button.addEventListener("click", all((view) => view.look(button.dataset.view))));
  const play = document.getElementById("play");
  let started = null;
  const step = (now) => {
    if (started === null) return;
    all((view) => { if (!view.moves) view.phase = Math.cos(((now - started) / 1600) * 2 * Math.PI); })();
    requestAnimationFrame(step);
  };
  if (play) play.addEventListener("click", () => {
    play.textContent = started === null ? "stop" : "play";
    if (started === null) { started = performance.now(); requestAnimationFrame(step); } else { started = null; all((view) => { view.phase = 1; })(); }
  });
}

function drawPlots() {
  const curves = Array.from(document.querySelectorAll(".stress-curves"), drawStress);
  return Promise.all([drawResponse(), drawErrors(), drawPoints(), drawSpectrum(), drawStages(), ...curves]);
}
function changeTheme() {
  takeTheme();
  drawPlots();
  for (const view of views) view.paint();
}
drawBodies();
drawPlots().then(() => requestAnimationFrame(() => {
  document.documentElement.dataset.ready = Math.round(performance.now());
  document.documentElement.dataset.bodies = views.length;
}));
for (const media of [dark, paper]) media.addEventListener("change", changeTheme);
