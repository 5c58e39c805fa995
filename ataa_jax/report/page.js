"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const $ = (id) => document.getElementById(id);
  const { width: W, height: H, reference: REF } = data;
  const byName = Object.fromEntries(data.methods.map((m) => [m.name, m]));
  const state = {
    left: data.left, right: data.right, index: data.frames.length - 1,
    show: "picture", zoom: 1, split: 0.5, x: W / 2, y: H / 2,
  };
  const stage = $("stage"), view = $("view"), divider = $("divider");
  const context = view.getContext("2d");

  // ---- pictures: decoded on demand, composed once per method, frame and kind

  const decoded = new Map(), composed = new Map(), KEEP = 96;

  function decode(uri) {
    if (!decoded.has(uri)) {
      const image = new Image();
      image.src = uri;
      decoded.set(uri, image.decode().then(() => image));
    }
    return decoded.get(uri);
  }

  // Why-bits of the pixel whose bytes start at i: green holds the low eight, blue the rest.
  const why = (m, i) => m[i + 1] | (m[i + 2] << 8);

  function pixels(image) {
    const canvas = document.createElement("canvas");
    canvas.width = W; canvas.height = H;
    const c = canvas.getContext("2d", { willReadFrequently: true });
    c.drawImage(image, 0, 0);
    return { canvas, c, data: c.getImageData(0, 0, W, H) };
  }

  const hasMap = (name) => Boolean(data.maps[name]);

  async function map(name, index) {
    return pixels(await decode(data.maps[name][index])).data.data;
  }

  async function compose(name, index, show) {
    const kind = (show === "mask" || show === "why") && !hasMap(name) ? "picture" : show;
    const key = `${name} ${index} ${kind}`;
    if (composed.has(key)) return composed.get(key);
    const picture = pixels(await decode(data.images[name][index]));
    const p = picture.data.data;
    if (kind === "error") {
      const r = pixels(await decode(data.images[REF][index])).data.data;
      for (let i = 0; i < p.length; i += 4)
        for (let c = 0; c < 3; c++) p[i + c] = 8 * Math.abs(p[i + c] - r[i + c]);
    } else if (kind !== "picture") {
      const m = await map(name, index);
      for (let i = 0; i < p.length; i += 4) {
        const luma = 0.2126 * p[i] + 0.7152 * p[i + 1] + 0.0722 * p[i + 2];
        let color = null, alpha = 0;
        if (kind === "mask") {
          const entry = data.mask[m[i]];
          if (entry) { color = entry.color; alpha = entry.alpha; }
        } else {
          const entry = data.reasons.find((r) => (why(m, i) & r.bits) === r.bits);
          if (entry) { color = entry.color; alpha = entry.alpha; }
        }
        for (let c = 0; c < 3; c++) p[i + c] = luma * (1 - alpha) + (color ? color[c] * alpha : 0);
      }
    }
    picture.c.putImageData(picture.data, 0, 0);
    composed.set(key, picture.canvas);
    if (composed.size > KEEP) composed.delete(composed.keys().next().value);
    return picture.canvas;
  }

  // ---- the stage

  let fit = 1; // device pixels an image pixel at zoom 1

  function measure() {
    const dpr = window.devicePixelRatio || 1;
    const wide = (Math.min(stage.parentElement.clientWidth, 1280) * dpr) / W;
    // Controls and scrubber stay in view beside the picture, unless it got tiny.
    const high = (Math.max(window.innerHeight - 170, 240) * dpr) / H;
    fit = Math.min(wide, Math.max(high, 1));
    // A whole number of screen pixels a pixel, where that changes the size little.
    const whole = Math.floor(fit < 1 ? fit : Math.min(wide, 1.2 * fit));
    if (whole >= 1 && whole / fit > 0.86) fit = whole;
    view.width = Math.round(W * fit); view.height = Math.round(H * fit);
    stage.style.width = `${view.width / dpr}px`;
    stage.style.height = `${view.height / dpr}px`;
  }

  const scale = () => (state.zoom === 1 ? fit : Math.max(1, Math.round(fit * state.zoom)));

  function clampCentre() {
    const s = scale(), halfW = view.width / s / 2, halfH = view.height / s / 2;
    state.x = Math.min(Math.max(state.x, halfW), Math.max(W - halfW, halfW));
    state.y = Math.min(Math.max(state.y, halfH), Math.max(H - halfH, halfH));
  }

  function origin() {
    const s = scale();
    return [Math.round(view.width / 2 - state.x * s), Math.round(view.height / 2 - state.y * s)];
  }

  let ticket = 0;

  async function draw() {
    const mine = ++ticket;
    const [a, b] = await Promise.all([
      compose(state.left, state.index, state.show),
      compose(state.right, state.index, state.show),
    ]);
    if (mine !== ticket) return; // a later call draws
    clampCentre();
    const s = scale(), [x, y] = origin();
    const edge = Math.round(state.split * view.width);
    context.imageSmoothingEnabled = s < 1 || !Number.isInteger(s);
    context.imageSmoothingQuality = "high";
    context.fillStyle = "#0b0c0e";
    context.fillRect(0, 0, view.width, view.height);
    for (const [picture, from, to] of [[a, 0, edge], [b, edge, view.width]]) {
      context.save();
      context.beginPath(); context.rect(from, 0, to - from, view.height); context.clip();
      context.drawImage(picture, x, y, W * s, H * s);
      context.restore();
    }
    stage.dataset.drawn = `${state.left} ${state.right} ${state.index} ${state.show} ${state.zoom}`;
  }

  const suffix = (name) => {
    if (state.show === "picture") return "";
    if (state.show === "error") return name === REF ? "" : ", error";
    if (!hasMap(name)) return ", no mask";
    return state.show === "mask" ? ", mask" : ", reasons";
  };

  const number = (value, digits) => (value === null || value === undefined ? "–" : value.toFixed(digits));

  function facts(name) {
    if (name === REF) return byName[name].label;
    const i = data.frames[state.index], s = data.series[name];
    if (!s) return byName[name].label;
    let text = `${byName[name].label}: SSIM ${number(s.ssim[i], 4)}, FLIP ${number(s.flip[i], 4)}`;
    if (hasMap(name)) text += `, ${number(100 * s.ataa_share[i], 1)} % traced`;
    return text;
  }

  function update() {
    $("left").value = state.left; $("right").value = state.right; $("frame").value = state.index;
    const percent = Math.round(100 * state.split);
    divider.style.left = `${100 * state.split}%`;
    divider.setAttribute("aria-valuenow", percent);
    divider.setAttribute("aria-valuetext",
      `${percent} percent ${byName[state.left].label}, ${100 - percent} percent ${byName[state.right].label}`);
    const shown = data.frames[state.index] + 1, last = data.frames[data.frames.length - 1] + 1;
    $("frame-text").textContent = `frame ${shown} of ${last}`;
    $("frame").setAttribute("aria-valuetext", `frame ${shown} of ${last}`);
    $("tag-left").textContent = byName[state.left].label + suffix(state.left);
    $("tag-right").textContent = byName[state.right].label + suffix(state.right);
    $("facts-left").textContent = facts(state.left);
    $("facts-right").textContent = facts(state.right);
    view.setAttribute("aria-label",
      `Frame ${shown}: ${byName[state.left].label} on the left, ${byName[state.right].label} on the right`);
    const maps = hasMap(state.left) || hasMap(state.right);
    $("legend-mask").hidden = !(maps && state.show === "mask");
    $("legend-why").hidden = !(maps && state.show === "why");
    stage.classList.toggle("zoomed", state.zoom > 1);
    for (const kind of ["show", "zoom"])
      document.querySelectorAll(`input[name=${kind}]`).forEach((radio) => {
        radio.checked = radio.value === String(state[kind]);
      });
    document.querySelectorAll("tr[data-method]").forEach((row) => {
      row.classList.toggle("is-left", row.dataset.method === state.left);
      row.classList.toggle("is-right", row.dataset.method === state.right);
    });
    draw();
    plots();
  }

  const set = (change) => { Object.assign(state, change); update(); };
  const step = (by) => {
    const n = data.frames.length;
    set({ index: (((state.index + by) % n) + n) % n });
  };

  // ---- pointer: the divider, panning, the probe

  function place(event) {
    const box = view.getBoundingClientRect();
    const dpr = view.width / box.width;
    const px = (event.clientX - box.left) * dpr, py = (event.clientY - box.top) * dpr;
    const [x, y] = origin(), s = scale();
    return { share: (event.clientX - box.left) / box.width, x: (px - x) / s, y: (py - y) / s, dpr };
  }

  const clamp01 = (v) => Math.min(Math.max(v, 0), 1);
  let drag = null;

  function grab(event, kind) {
    if (event.button !== 0) return;
    event.currentTarget.setPointerCapture(event.pointerId);
    drag = { kind, clientX: event.clientX, clientY: event.clientY, x: state.x, y: state.y };
    stage.classList.toggle("panning", kind === "pan");
    if (kind === "split") set({ split: clamp01(place(event).share) });
  }

  function move(event) {
    if (!drag) return;
    if (drag.kind === "split") { set({ split: clamp01(place(event).share) }); return; }
    const { dpr } = place(event), s = scale();
    set({ x: drag.x - ((event.clientX - drag.clientX) * dpr) / s, y: drag.y - ((event.clientY - drag.clientY) * dpr) / s });
  }

  function release() { drag = null; stage.classList.remove("panning"); }

  divider.addEventListener("pointerdown", (e) => grab(e, "split"));
  view.addEventListener("pointerdown", (e) => grab(e, state.zoom > 1 ? "pan" : "split"));
  for (const target of [divider, view]) {
    target.addEventListener("pointermove", move);
    target.addEventListener("pointerup", release);
    target.addEventListener("pointercancel", release);
  }
  view.addEventListener("dblclick", (event) => {
    const at = place(event);
    set({ zoom: { 1: 2, 2: 4, 4: 1 }[state.zoom], x: at.x, y: at.y });
  });

  async function probe(event) {
    const at = place(event), x = Math.floor(at.x), y = Math.floor(at.y);
    if (x < 0 || y < 0 || x >= W || y >= H) { $("probe").textContent = ""; return; }
    let text = `x ${x}, y ${y}`;
    const name = [at.share < state.split ? state.left : state.right, state.left, state.right].find(hasMap);
    if (name) {
      const m = await probeMap(name, state.index), i = 4 * (y * W + x);
      const method = data.mask[m[i]];
      const reasons = data.reasons.filter((r) => (why(m, i) & r.bits) === r.bits && (r.bits & (r.bits - 1)) === 0);
      text += `: ${method ? method.name : "?"}${reasons.length ? ` (${reasons.map((r) => r.name).join(", ")})` : ""}`;
    }
    $("probe").textContent = text;
  }
  let probed = { key: "", map: null };
  async function probeMap(name, index) {
    const key = `${name} ${index}`;
    if (probed.key !== key) probed = { key, map: map(name, index) };
    return probed.map;
  }
  view.addEventListener("pointermove", probe);
  view.addEventListener("pointerleave", () => { $("probe").textContent = ""; });

  // ---- controls and keys

  for (const side of ["left", "right"])
    $(side).addEventListener("change", (e) => set({ [side]: e.target.value }));
  $("swap").addEventListener("click", () => set({ left: state.right, right: state.left }));
  $("frame").addEventListener("input", (e) => set({ index: Number(e.target.value) }));
  document.querySelectorAll("input[name=show]").forEach((radio) =>
    radio.addEventListener("change", () => set({ show: radio.value })));
  document.querySelectorAll("input[name=zoom]").forEach((radio) =>
    radio.addEventListener("change", () => set({ zoom: Number(radio.value) })));

  let timer = null;
  function play() {
    if (timer) { clearInterval(timer); timer = null; } else timer = setInterval(() => step(1), 160);
    $("play").textContent = timer ? "❚❚" : "▶";
    $("play").setAttribute("aria-pressed", String(Boolean(timer)));
    $("play").setAttribute("aria-label", timer ? "Pause" : "Play");
  }
  $("play").addEventListener("click", play);

  divider.addEventListener("keydown", (event) => {
    const by = { ArrowLeft: -0.02, ArrowRight: 0.02, PageDown: -0.1, PageUp: 0.1 }[event.key];
    const to = { Home: 0, End: 1 }[event.key];
    if (by === undefined && to === undefined) return;
    event.preventDefault(); event.stopPropagation();
    set({ split: clamp01(to === undefined ? state.split + by : to) });
  });

  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const tag = event.target.tagName;
    if (tag === "SELECT" || (tag === "INPUT" && event.key.startsWith("Arrow"))) return;
    if (tag === "BUTTON" && event.key === " ") return;
    const pan = 24 / scale();
    const keys = {
      ArrowLeft: () => (event.shiftKey ? set({ x: state.x - pan }) : step(-1)),
      ArrowRight: () => (event.shiftKey ? set({ x: state.x + pan }) : step(1)),
      ArrowUp: event.shiftKey && (() => set({ y: state.y - pan })),
      ArrowDown: event.shiftKey && (() => set({ y: state.y + pan })),
      " ": play,
      s: () => set({ left: state.right, right: state.left }),
      m: () => set({ show: state.show === "mask" ? "picture" : "mask" }),
      1: () => set({ zoom: 1 }), 2: () => set({ zoom: 2 }), 4: () => set({ zoom: 4 }),
    };
    const act = keys[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (act) { event.preventDefault(); act(); }
  });

  // ---- plots

  const svg = (name, attributes, ...children) => {
    const node = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    node.append(...children);
    return node;
  };

  function ticks(low, high, count) {
    const raw = (high - low) / count, power = 10 ** Math.floor(Math.log10(raw));
    const size = [1, 2, 2.5, 5, 10].map((k) => k * power).find((k) => k >= raw);
    const out = [];
    for (let v = Math.ceil(low / size) * size; v <= high + size * 1e-9; v += size) out.push(v);
    return { out, digits: Math.max(0, -Math.floor(Math.log10(size) + 1e-9) + (size / power === 2.5 ? 1 : 0)) };
  }

  // Pushes labels apart, keeping their order.
  function spread(labels, gap, top, bottom) {
    labels.sort((a, b) => a.y - b.y);
    let y = top;
    for (const l of labels) { l.y = Math.max(l.y, y); y = l.y + gap; }
    y = bottom;
    for (const l of [...labels].reverse()) { l.y = Math.min(l.y, y); y = l.y - gap; }
  }

  const color = (m) => `var(--${m.family})`;
  const strong = (m) => m.name === state.left || m.name === state.right;
  const P = { w: 600, h: 330, l: 52, r: 168, t: 10, b: 40 };

  function frame(into, low, high, x) {
    const root = svg("svg", { viewBox: `0 0 ${P.w} ${P.h}`, role: "img", "aria-label": into.dataset.label });
    const { out, digits } = ticks(low, high, 5);
    const y = (v) => P.h - P.b - ((v - low) / (high - low || 1)) * (P.h - P.b - P.t);
    for (const v of out)
      root.append(
        svg("line", { class: "grid", x1: P.l, x2: P.w - P.r, y1: y(v), y2: y(v) }),
        svg("text", { x: P.l - 8, y: y(v) + 4, "text-anchor": "end" }, v.toFixed(digits)));
    for (const [at, text] of x.ticks)
      root.append(svg("text", { x: x.of(at), y: P.h - P.b + 17, "text-anchor": "middle" }, text));
    root.append(
      svg("line", { class: "axis", x1: P.l, x2: P.w - P.r, y1: P.h - P.b, y2: P.h - P.b }),
      svg("text", { x: (P.l + P.w - P.r) / 2, y: P.h - 4, "text-anchor": "middle" }, x.title));
    into.replaceChildren(root);
    return { root, y };
  }

  function nothing(into) {
    const p = document.createElement("p");
    p.textContent = "This score is not defined for these frames.";
    into.replaceChildren(p);
  }

  function overFrames() {
    const into = $("plot-frames"), name = $("metric").value;
    const column = data.columns.find((c) => c.name === name);
    into.dataset.label = `${column.heading} over frames`;
    const drawn = data.methods
      .filter((m) => m.name !== REF && data.series[m.name])
      .filter((m) => !name.endsWith("_share") || hasMap(m.name))
      .map((m) => ({ m, values: data.series[m.name][name].map((v) => (v === null ? null : v * column.scale)) }))
      .filter(({ values }) => values.some((v) => v !== null));
    const all = drawn.flatMap(({ values }) => values.filter((v) => v !== null));
    if (!all.length) { nothing(into); return; }
    let low = Math.min(...all), high = Math.max(...all);
    const pad = 0.06 * (high - low) || 0.05 * Math.abs(high) || 1;
    low = name.endsWith("_share") ? 0 : low - pad; high += pad;
    const n = drawn[0].values.length, span = Math.max(n - 1, 1);
    const of = (i) => P.l + 8 + (i / span) * (P.w - P.r - P.l - 16);
    const every = Math.ceil(n / 12);
    const marks = [...Array(n).keys()].filter((i) => i % every === 0).map((i) => [i, String(i + 1)]);
    const { root, y } = frame(into, low, high, { of, ticks: marks, title: "frame" });
    const at = of(data.frames[state.index]);
    root.append(svg("line", { class: "cursor", x1: at, x2: at, y1: P.t, y2: P.h - P.b }));
    const labels = [];
    for (const { m, values } of [...drawn].sort((a, b) => strong(a.m) - strong(b.m))) {
      const points = values.map((v, i) => (v === null ? null : [of(i), y(v)])).filter(Boolean);
      const group = svg("g", strong(m) ? { class: "strong" } : {});
      const style = `stroke:${color(m)}${m.dashed ? ";stroke-dasharray:5 3" : ""}`;
      group.append(svg("polyline", { class: "line", style, points: points.map((p) => p.join(",")).join(" ") }));
      if (strong(m) || n === 1)
        for (const [cx, cy] of points) group.append(svg("circle", { cx, cy, r: 2.6, style: `fill:${color(m)}` }));
      root.append(group);
      labels.push({ m, from: points[points.length - 1][1], y: points[points.length - 1][1] });
    }
    writeLabels(root, labels, P.w - P.r);
    root.append(...[...Array(data.frames.length).keys()].map((k) => {
      const half = (P.w - P.r - P.l - 16) / span / 2;
      const hit = svg("rect", { class: "hit", x: of(data.frames[k]) - half, width: 2 * half, y: P.t, height: P.h - P.b - P.t });
      hit.addEventListener("click", () => set({ index: k }));
      return hit;
    }));
  }

  function writeLabels(root, labels, x) {
    spread(labels, 14, P.t + 4, P.h - P.b - 2);
    for (const l of labels)
      root.append(
        svg("polyline", { class: "line", style: `stroke:${color(l.m)};stroke-width:1`, points: `${x - 6},${l.from} ${x + 6},${l.y} ${x + 12},${l.y}` }),
        svg("text", { class: strong(l.m) ? "strong" : "", x: x + 16, y: l.y + 4 }, l.m.label));
  }

  function againstCost() {
    const into = $("plot-cost");
    into.dataset.label = "1 minus SSIM against samples a pixel";
    const drawn = data.methods
      .filter((m) => m.name !== REF && data.means[m.name] && data.means[m.name].one_minus_ssim !== null)
      .map((m) => ({ m, cost: m.cost, value: data.means[m.name].one_minus_ssim }));
    if (!drawn.length) { nothing(into); return; }
    const most = Math.max(2, ...drawn.map((d) => d.cost));
    const of = (v) => P.l + 12 + (Math.log2(v) / Math.log2(most)) * (P.w - 30 - P.l - 24);
    const wide = P.r; P.r = 30;
    const marks = [1, 1.5, 2, 4, 8, 16, 32].filter((v) => v <= most).map((v) => [v, String(v)]);
    const high = 1.08 * Math.max(...drawn.map((d) => d.value));
    const { root, y } = frame(into, 0, high, { of, ticks: marks, title: "samples a pixel" });
    P.r = wide;
    const chain = drawn.filter((d) => d.m.family === "ssaa").sort((a, b) => a.cost - b.cost);
    if (chain.length > 1)
      root.append(svg("polyline", { class: "line", style: "stroke:var(--ssaa)", points: chain.map((d) => `${of(d.cost)},${y(d.value)}`).join(" ") }));
    // Each label takes the first place beside its point that is still free.
    const points = drawn.map((d) => ({ ...d, x: of(d.cost), y: y(d.value) }));
    const taken = points.map((p) => [p.x - 6, p.y - 6, p.x + 6, p.y + 6]);
    const free = (box) => box[0] > P.l && box[2] < P.w && box[1] > 0 && box[3] < P.h - P.b + 2 &&
      !taken.some((t) => t[0] < box[2] && t[2] > box[0] && t[1] < box[3] && t[3] > box[1]);
    for (const p of [...points].sort((a, b) => strong(b.m) - strong(a.m))) {
      const bold = strong(p.m), long = p.m.label.length * (bold ? 7.1 : 6.5);
      const spots = [[10, 0], [-long - 10, 0]];
      for (let up = 1; up <= 6; up++)
        for (const sign of [-1, 1]) spots.push([8, sign * 13 * up], [-long / 2, sign * 13 * up], [-long - 8, sign * 13 * up]);
      const box = ([dx, dy]) => [p.x + dx, p.y + dy - 7, p.x + dx + long, p.y + dy + 6];
      const spot = spots.find((each) => free(box(each))) || spots[0];
      taken.push(box(spot));
      const style = p.m.dashed ? `fill:var(--paper);stroke:${color(p.m)};stroke-width:1.6` : `fill:${color(p.m)}`;
      if (Math.abs(spot[1]) > 26)
        root.append(svg("line", { class: "grid", x1: p.x, y1: p.y, x2: p.x + spot[0] + (spot[0] < -20 ? long : 0), y2: p.y + spot[1] }));
      root.append(
        svg("circle", { cx: p.x, cy: p.y, r: bold ? 6 : 4.4, style }),
        svg("text", { class: bold ? "strong" : "", x: p.x + spot[0], y: p.y + spot[1] + 4 }, p.m.label));
    }
  }

  function plots() { overFrames(); againstCost(); }
  $("metric").addEventListener("change", plots);

  window.addEventListener("resize", () => { measure(); draw(); });
  new ResizeObserver(() => { measure(); draw(); }).observe(stage.parentElement);
  measure();
  update();
  document.documentElement.dataset.ready = "true";
})();
