"use strict";
// Arrays come as base64 of little-endian numbers: {dtype, shape, bdata}.
const KINDS = { f4: Float32Array, f8: Float64Array, u4: Uint32Array };
function numbers(packed) {
  const text = atob(packed.bdata), bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  return new KINDS[packed.dtype](bytes.buffer);
}
const data = JSON.parse(document.getElementById("data").textContent);
const COLOURS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00"];
const MORE = ["#999999", "#f0e442", "#44525a", "#8c510a", "#762a83", "#b2df8a", "#c7e9ff", "#fdbf6f"]; // of stages
const DASHES = ["solid", "dash", "dot", "dashdot"];
const INK = "#26323a";
const BUTTONS = { displaylogo: false, responsive: true, modeBarButtons: [["toImage", "zoom2d", "pan2d", "autoScale2d", "resetScale2d"]] };
const axis = (title, more) => ({ title: { text: title, standoff: 8 }, automargin: true, gridcolor: "#e3e8eb", zeroline: false, linecolor: "#b9c3c9", ...more });
const layout = (more) => ({
  font: { family: "system-ui, sans-serif", size: 13, color: INK }, margin: { l: 78, r: 20, t: 12, b: 46 },
  paper_bgcolor: "white", plot_bgcolor: "white", hovermode: "closest", legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0 }, ...more,
});
const plain = (text) => text.replace(/&/g, "&amp;").replace(/</g, "&lt;"); // Plotly takes <a> and <b> for marks
const named = (i) => plain(data.results[i].name);
const positive = (value) => (value > 0 ? value : null);
const powers = { type: "log", exponentformat: "power", nticks: 4 }; // few, so that those of 2 and 5 never touch

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
      const marker = { color: data.several_full ? COLOURS[i % COLOURS.length] : INK, size: 7, symbol: "circle-open", line: { width: 1.5 } };
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
  return Plotly.newPlot("error", traces, layout({ shapes, annotations: words, showlegend: true, xaxis: axis("frequency (Hz)"), yaxis: axis("relative error eps", powers) }), BUTTONS);
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
  return Plotly.newPlot("points", traces, layout({ shapes, showlegend: true, xaxis: axis("expansion points", { dtick: 1 }), yaxis: axis("largest estimate over the band", powers) }), BUTTONS);
}
function drawSpectrum() {
  const traces = [];
  const row = (x, y, colour) => ({ x, y: x.map(() => y), mode: "markers", name: y, showlegend: false, marker: { symbol: "line-ns-open", size: 22, color: colour, line: { width: 2, color: colour } }, hovertemplate: "%{x:.6g} Hz<extra></extra>" });
  const modes = data.results.find((result) => result.modes);
  if (modes) traces.push(row(Array.from(numbers(modes.modes)), "modes of the model", INK));
  data.results.forEach((result, i) => traces.unshift(row(Array.from(numbers(result.pseudo)), named(i), COLOURS[i % COLOURS.length])));
  const top = data.band ? 1.6 * data.band[1] : undefined;
  const shapes = data.band ? [{ type: "rect", x0: data.band[0], x1: data.band[1], yref: "paper", y0: 0, y1: 1, fillcolor: "#eef3f6", line: { width: 0 }, layer: "below" }] : [];
  return Plotly.newPlot("spectrum", traces, layout({ shapes, margin: { l: 160, r: 20, t: 12, b: 46 }, xaxis: axis("frequency (Hz); the band is grey", top ? { range: [0, top] } : {}), yaxis: axis("", { type: "category", automargin: true }) }), BUTTONS);
}
function drawStages() {
  const longest = (stage) => Math.max(...data.results.map((result) => result.seconds[stage] || 0));
  const stages = [...new Set(data.results.flatMap((result) => Object.keys(result.seconds)))].sort((a, b) => longest(b) - longest(a));
  const traces = stages.map((stage, k) => ({ type: "bar", orientation: "h", name: plain(stage), y: data.results.map((_, i) => named(i)), x: data.results.map((result) => result.seconds[stage] || 0), marker: { color: [...COLOURS, ...MORE][k % 14] }, hovertemplate: plain(stage) + " %{x:.3g} s<extra></extra>" }));
  return Plotly.newPlot("stages", traces, layout({ barmode: "stack", margin: { l: 160, r: 20, t: 30, b: 46 }, legend: { orientation: "h", y: -0.25, yanchor: "top", x: 0, traceorder: "normal" }, xaxis: axis("", { ticksuffix: " s" }), yaxis: axis("", { type: "category", automargin: true, autorange: "reversed" }) }), BUTTONS);
}

// ---------------------------------------------------------------- bodies
const VERTEX = `
attribute vec3 displacement;
uniform float amplitude; uniform float point;
varying float size; varying vec3 place;
void main() {
  size = length(displacement) * min(abs(amplitude), 1.0);
  vec4 seen = modelViewMatrix * vec4(position + amplitude * SWING * displacement, 1.0);
  place = seen.xyz;
  gl_PointSize = point;
  gl_Position = projectionMatrix * seen;
}`;
const COLOURED = `
varying float size; varying vec3 place;
const vec3 stops[9] = vec3[9](vec3(0.267, 0.004, 0.329), vec3(0.278, 0.176, 0.482), vec3(0.231, 0.322, 0.545), vec3(0.173, 0.447, 0.557), vec3(0.129, 0.569, 0.549), vec3(0.157, 0.682, 0.502), vec3(0.369, 0.788, 0.384), vec3(0.678, 0.863, 0.188), vec3(0.992, 0.906, 0.145));
vec3 viridis(float t) {
  t = 8.0 * clamp(t, 0.0, 1.0);
  int k = min(int(t), 7);
  return mix(stops[k], stops[k + 1], t - float(k));
}`;
const SURFACE = COLOURED + `
void main() {
  vec3 normal = normalize(cross(dFdx(place), dFdy(place)));
  if (normal.z < 0.0) normal = -normal;
  float light = 0.5 + 0.5 * max(dot(normal, normalize(vec3(-0.35, 0.45, 0.82))), 0.0);
  gl_FragColor = vec4(viridis(size) * light, 1.0);
}`;
const DOTS = COLOURED + `
void main() {
  float r = length(gl_PointCoord - 0.5);
  if (r > 0.5) discard;
  gl_FragColor = vec4(viridis(size) * (1.0 - 1.4 * r * r), 1.0);
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
    this.renderer = new THREE.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    this.renderer.setClearColor(0xffffff);
    element.appendChild(this.renderer.domElement);
    this.scene = new THREE.Scene();
    this.place = new THREE.BufferAttribute(numbers(shape.points), 3);
    this.fields = shape.fields.map((field) => new THREE.BufferAttribute(numbers(field), 3));
    this.amplitude = { value: 1 }; this.still = { value: 0 };
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
    const uniforms = { amplitude, point: { value: point * this.renderer.getPixelRatio() }, colour: { value: new THREE.Vector3(...(more.colour || [0, 0, 0])) } };
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
    for (const geometry of this.geometries) geometry.setAttribute("displacement", this.fields[mode]);
    this.draw();
  }
  draw() { // once, however much has changed until the next frame
    this.waiting ??= requestAnimationFrame(() => { this.waiting = null; this.paint(); });
  }
  paint() {
    this.amplitude.value = this.phase * Number(document.getElementById("amplitude").value);
    this.renderer.render(this.scene, this.camera);
    const v = new THREE.Vector3(), p = this.place.array, u = this.fields[this.mode].array, a = this.amplitude.value * this.shape.swing;
    this.tags.forEach((tag, k) => {
      const i = 3 * this.markIndex[k];
      v.set(p[i] + a * u[i], p[i + 1] + a * u[i + 1], p[i + 2] + a * u[i + 2]).project(this.camera);
      tag.style.left = ((v.x + 1) / 2) * this.wide + 8 + "px"; tag.style.top = ((1 - v.y) / 2) * this.tall - 18 + "px";
      tag.style.display = this.marks.visible ? "" : "none";
    });
    let lines = "";
    this.triad.forEach((tag, k) => {
      v.set(0, 0, 0).setComponent(k, 1).transformDirection(this.camera.matrixWorldInverse);
      lines += `<line x1="35" y1="35" x2="${35 + 22 * v.x}" y2="${35 - 22 * v.y}" stroke="#667680" stroke-width="1.5"/>`;
      tag.style.left = 8 + 35 + 30 * v.x - 4 + "px"; tag.style.top = this.tall - 8 - 70 + 35 - 30 * v.y - 9 + "px";
    });
    this.arrows.innerHTML = lines;
  }
}

const views = [];
function drawBodies() {
  document.querySelectorAll(".view").forEach((element) => {
    const result = data.results[Number(element.dataset.result)], slider = element.parentNode.querySelector(".mode");
    const told = element.parentNode.querySelector(".frequency");
    let view;
    try {
      view = new BodyView(element, result.shape);
    } catch (error) {
      element.textContent = "This browser shows no three-dimensional pictures (WebGL): " + error.message;
      return;
    }
    views.push(view);
    const choose = () => { view.show(Number(slider.value) - 1); told.textContent = result.shape.names[view.mode]; };
    slider.addEventListener("input", choose);
    const wanted = /mode=(\d+)/.exec(location.hash); // report.html#mode=3
    if (wanted) slider.value = wanted[1];
    choose();
  });
  const all = (change) => () => { for (const view of views) { change(view); view.draw(); } };
  const on = (id, kind, change) => { const found = document.getElementById(id); if (found) found.addEventListener(kind, () => all((view) => change(view, found))()); };
  on("outline", "change", (view, box) => { view.outline.visible = box.checked; });
  on("mesh", "change", (view, box) => { view.mesh.visible = box.checked; });
  on("interface", "change", (view, box) => { view.marks.visible = box.checked; });
  on("amplitude", "input", () => {});
  document.querySelectorAll("[data-view]").forEach((button) => button.addEventListener("click", all((view) => view.look(button.dataset.view))));
  const play = document.getElementById("play");
  let started = null;
  const step = (now) => {
    if (started === null) return;
    all((view) => { view.phase = Math.cos(((now - started) / 1600) * 2 * Math.PI); })();
    requestAnimationFrame(step);
  };
  if (play) play.addEventListener("click", () => {
    play.textContent = started === null ? "stop" : "play";
    if (started === null) { started = performance.now(); requestAnimationFrame(step); } else { started = null; all((view) => { view.phase = 1; })(); }
  });
}

drawBodies();
Promise.all([drawResponse(), drawErrors(), drawPoints(), drawSpectrum(), drawStages()]).then(() => requestAnimationFrame(() => {
  document.documentElement.dataset.ready = Math.round(performance.now());
  document.documentElement.dataset.bodies = views.length;
}));
