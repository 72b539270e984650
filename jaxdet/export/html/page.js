"use strict";
// Draws the report from the JSON in the page. Texts from logs only ever become text nodes.
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const $ = (id) => document.getElementById(id);
  const SVG = "http://www.w3.org/2000/svg";
  const calm = matchMedia("(prefers-reduced-motion: reduce)").matches;

  function add(parent, name, attributes = {}, text) {
    const space = parent.namespaceURI === SVG || name === "svg" ? SVG : parent.namespaceURI;
    const node = document.createElementNS(space, name);
    for (const [key, value] of Object.entries(attributes)) {
      if (value !== null && value !== undefined) node.setAttribute(key, value);
    }
    if (text !== undefined) node.textContent = text;
    parent.appendChild(node);
    return node;
  }
  const clear = (node) => { while (node.firstChild) node.firstChild.remove(); return node; };
  const many = (n, word) => `${n.toLocaleString("en")} ${word}${n === 1 ? "" : "s"}`;
  const metres = (value) => (value === null || value === undefined ? "–" : `${value.toFixed(2)} m`);
  const seconds = (value) => {
    if (value < 60) return `${value.toFixed(2)} s`;
    const whole = Math.floor(value), two = (n) => String(n).padStart(2, "0");
    const h = Math.floor(whole / 3600), m = Math.floor(whole / 60) % 60;
    return h ? `${h}:${two(m)}:${two(whole % 60)} h` : `${m}:${two(whole % 60)} min`;
  };
  const date = (log) => (log.begin ? new Date(log.begin * 1000).toISOString().replace("T", " ").slice(0, 19) + " UTC" : "");
  const share = (part, whole) => {
    const p = (100 * part) / whole;
    return p === 100 || !part ? `${p} %` : part && p < 0.1 ? "< 0.1 %" : p < 100 && p > 99.9 ? "> 99.9 %" : `${p.toFixed(p < 10 || p > 99 ? 1 : 0)} %`;
  };

  function table(parent, head, rows) {
    const node = parent.tagName === "TABLE" ? clear(parent) : add(parent, "table");
    const numeric = head.map((h) => h.startsWith("#"));
    const top = add(add(node, "thead"), "tr");
    head.forEach((h, i) => add(top, "th", { scope: "col", class: numeric[i] ? "n" : null }, h.replace("#", "")));
    const body = add(node, "tbody");
    for (const row of rows) {
      const line = add(body, "tr");
      row.forEach((cell, i) => add(line, "td", { class: numeric[i] ? "n" : null, "data-head": head[i].replace("#", "") }).append(cell));
    }
    return node;
  }

  // The number of an obstacle with its colour in the pictures.
  function obstacle(number) {
    const node = document.createElement("span");
    add(node, "span", { class: "key" }).style.background = data.palette[number % data.palette.length];
    node.append(String(number));
    return node;
  }

  // Index of the log chosen above, -1 for all logs.
  let only = -1;
  const logs = () => data.logs.map((_, i) => i).filter((i) => only < 0 || i === only);
  const picked = () => logs().map((i) => data.logs[i]);
  const sum = (of) => picked().reduce((total, log) => total + of(log), 0);

  // ---- summary
  function drawFigures() {
    const node = clear($("figures"));
    const frames = sum((l) => l.frames), ok = sum((l) => l.status.ok || 0);
    const obstacles = sum((l) => l.obstacles), overflow = sum((l) => l.overflow);
    const floorless = sum((l) => l.floorless);
    const whole = picked().filter((l) => !l.error), failed = picked().length - whole.length;
    const nearest = whole.filter((l) => l.nearest).sort((a, b) => a.nearest[0] - b.nearest[0])[0];
    const card = (name, value, below) => {
      const part = add(node, "div");
      add(part, "dt", {}, name);
      const dd = add(part, "dd", {}, value);
      if (below) add(dd, "small", {}, below);
    };
    card("Logs", whole.length.toLocaleString("en"), failed ? `${failed} more failed` : seconds(sum((l) => l.duration || 0)));
    card("Frames", frames.toLocaleString("en"), frames ? `${share(ok, frames)} with a result` : "");
    card("Without a result", (frames - ok).toLocaleString("en"), frames - ok ? share(frames - ok, frames) : "none lost");
    card("Obstacles", obstacles.toLocaleString("en"), ok ? `${(obstacles / ok).toFixed(1)} per frame` : "");
    card("Nearest", nearest ? metres(nearest.nearest[0]) : "–", nearest ? `${data.logs.length > 1 ? nearest.log + ", " : ""}frame ${nearest.nearest[1]}` : "");
    if (floorless) card("No floor", floorless.toLocaleString("en"), "frames; their obstacles have no distance");
    card("Overflow", overflow.toLocaleString("en"), overflow ? "frames in which obstacles may be lost" : "no frame");
  }

  function drawLost() {
    const node = clear($("lost"));
    const counts = {};
    for (const log of picked()) {
      for (const [status, n] of Object.entries(log.status)) if (status !== "ok" && n) counts[status] = (counts[status] || 0) + n;
    }
    const rows = Object.entries(counts).sort((a, b) => b[1] - a[1]);
    const frames = sum((l) => l.frames), failed = picked().filter((l) => l.error);
    if (!rows.length && !failed.length) add(node, "p", {}, "None: each frame has a result.");
    if (rows.length) table(node, ["Status", "Why", "#Frames", "#Share"], rows.map(([s, n]) => [s, data.reasons[s] || "", n.toLocaleString("en"), share(n, frames)]));
    if (failed.length) {
      add(node, "p", { class: "bad" }, `${many(failed.length, "log")} failed:`);
      const list = add(node, "ul");
      for (const log of failed) add(list, "li", {}, log.error);
    }
    const lines = picked().flatMap((l) => l.errors.map((e) => (data.logs.length > 1 ? `${l.log}: ${e}` : e)));
    if (lines.length) {
      const more = add(node, "details");
      add(more, "summary", {}, `In detail, ${many(lines.length, "frame")}`);
      const list = add(more, "ul");
      for (const line of lines.slice(0, 200)) add(list, "li", {}, line);
    }
  }

  // ---- timelines
  const tip = $("tip");
  function showTip(x, y, text) {
    tip.textContent = text;
    tip.hidden = false;
    const box = tip.getBoundingClientRect();
    tip.style.left = `${Math.max(4, Math.min(innerWidth - box.width - 4, x - box.width / 2))}px`;
    tip.style.top = `${Math.max(4, y - box.height - 12)}px`;
  }
  const hideTip = () => { tip.hidden = true; };
  // Browsers report a move of a resting pointer if the page changes below it, for instance when the
  // dialog closes.
  let pointer = "", rests = false;
  document.addEventListener("pointermove", (e) => {
    const here = `${e.clientX} ${e.clientY}`;
    rests = here === pointer;
    pointer = here;
  }, true);

  const byFrame = new Map(data.frames.map((f, i) => [`${f.log} ${f.frame}`, i]));
  const { reach } = data;
  const TICKS = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 14400, 43200];
  const STEP = 10; // timelines drawn at first, and with each press of the button
  let drawn = STEP;

  function drawTimelines() {
    const node = clear($("timelines"));
    const some = logs().filter((i) => data.logs[i].bins);
    $("lost-key").hidden = !some.some((i) => data.logs[i].bins.lost.some((n) => n));
    if (!some.length) add(node, "p", {}, "No frames.");
    for (const i of some.slice(0, drawn)) timeline(node, i);
    if (some.length > drawn) {
      const button = add(node, "button", { type: "button" }, `Show more (${some.length - drawn} further logs)`);
      button.addEventListener("click", () => { drawn += STEP; drawTimelines(); });
    }
  }

  function timeline(parent, index) {
    const log = data.logs[index], { nearest, frame, time, lost, most } = log.bins, n = nearest.length;
    const W = Math.max(320, Math.min(1140, parent.clientWidth)), H = W < 560 ? 132 : 150;
    const left = 38, right = W - 8, top = 8, bottom = H - 24;
    // The horizontal axis is time if the timestamps increase, else the frame number.
    const begin = time[0], span = time[n - 1] - begin;
    const forward = span > 0 && time.every((t, b) => !b || t >= time[b - 1]);
    const pad = Math.min(6, (right - left) / (2 * n));
    const part = (b) => (forward ? (time[b] - begin) / span : n > 1 ? b / (n - 1) : 0.5);
    const x = (b) => left + pad + part(b) * (right - left - 2 * pad);
    const gaps = time.slice(1).map((t, b) => t - time[b]).sort((a, b) => a - b);
    const hole = Math.max(0.5, 6 * (gaps[Math.floor(gaps.length / 2)] || 0)); // longer gaps [s] have no frames
    const y = (d) => bottom - (Math.min(d, reach) / reach) * (bottom - top);
    const box = add(parent, "div", { class: "timeline" });
    const title = add(box, "h3");
    title.append(log.log);
    add(title, "span", {}, `${many(log.frames, "frame")}${log.stride > 1 ? `, ${log.stride} to a point` : ""}`);
    const least = log.nearest ? `nearest ${metres(log.nearest[0])} in frame ${log.nearest[1]}` : log.obstacles ? "no distance" : "no obstacle";
    const svg = add(box, "svg", { viewBox: `0 0 ${W} ${H}`, tabindex: "0", role: "application", "aria-roledescription": "timeline",
      "aria-label": `Distance to the nearest obstacle in ${log.log}: ${many(log.frames, "frame")}, ${least}. Arrow keys move, Enter opens a frame.` });
    const steps = reach > 60 ? 20 : reach > 24 ? 10 : reach > 12 ? 4 : reach > 4 ? 2 : reach > 2 ? 1 : 0.5;
    for (let d = 0; d <= reach + 1e-9; d += steps) {
      add(svg, "line", { class: "rule", x1: left, x2: right, y1: y(d), y2: y(d) });
      add(svg, "text", { x: left - 6, y: y(d) + 4, "text-anchor": "end" }, `${d} m`);
    }
    for (const [px, text] of forward ? timeTicks() : frameTicks()) {
      add(svg, "text", { x: px, y: H - 8, "text-anchor": px < left + 20 ? "start" : px > right - 30 ? "end" : "middle" }, text);
    }
    function timeTicks() {
      const most = Math.max(2, (right - left) / 90), step = TICKS.find((s) => span / s <= most) || 86400;
      const first = Math.ceil(begin / step), last = Math.floor((begin + span) / step + 1e-9);
      const ticks = Array.from({ length: last - first + 1 }, (_, i) => (first + i) * step);
      return ticks.map((t) => [left + pad + ((t - begin) / span) * (right - left - 2 * pad), t < 60 ? `${+t.toFixed(2)} s` : seconds(t)]);
    }
    function frameTicks() {
      const most = n > 1 ? Math.max(2, Math.round((right - left) / 160)) : 0;
      return Array.from({ length: most + 1 }, (_, i) => Math.round((i / (most || 1)) * (n - 1))).map((b) => [x(b), seconds(time[b])]);
    }
    // Frames with an obstacle are drawn as areas and lines; gaps are frames without one.
    let run = [];
    const flush = () => {
      if (run.length) {
        const points = run.map((b) => `${x(b).toFixed(1)},${y(nearest[b]).toFixed(1)}`);
        const wide = run.length > 1 ? points : [`${x(run[0]) - 1.5},${y(nearest[run[0]])}`, `${x(run[0]) + 1.5},${y(nearest[run[0]])}`];
        const first = wide[0].split(",")[0], last = wide[wide.length - 1].split(",")[0];
        add(svg, "polygon", { class: "fill", points: `${first},${bottom} ${wide.join(" ")} ${last},${bottom}` });
        add(svg, "polyline", { class: "line", points: wide.join(" ") });
      }
      run = [];
    };
    for (let b = 0; b < n; b++) {
      if (nearest[b] === null || (b && time[b] - time[b - 1] > hole)) flush();
      if (nearest[b] !== null) run.push(b);
    }
    flush();
    const each = Math.max(2, (right - left) / n);
    for (let b = 0; b < n; b++) {
      if (lost[b]) add(svg, "rect", { class: "lost", x: x(b) - each / 2, y: bottom, width: each, height: 4 });
    }
    const shots = data.frames.map((f, i) => [f, i]).filter(([f]) => f.log === index && f.picture);
    const place = shots.map(([f]) => Math.min(n - 1, Math.floor(f.place / log.stride)));
    shots.forEach(([f], k) => {
      if (f.nearest !== null) add(svg, "circle", { class: "dot", cx: x(place[k]), cy: y(f.nearest), r: 3 });
    });
    const cursor = add(svg, "line", { class: "cursor", y1: top, y2: bottom, visibility: "hidden" });
    const spot = add(svg, "circle", { class: "spot", r: 3.5, visibility: "hidden" });
    let at = -1;
    const say = (b) => {
      const parts = [`frame ${frame[b]}`, seconds(time[b]), nearest[b] === null ? (most[b] > 0 ? "no distance" : "no obstacle") : metres(nearest[b])];
      if (most[b] > 0) parts.push(log.stride > 1 ? `up to ${most[b]} obstacles` : many(most[b], "obstacle"));
      if (lost[b]) parts.push(log.stride > 1 ? `${lost[b]} without a result` : "no result");
      if (target(b) >= 0) parts.push("picture");
      return parts.join(" · ");
    };
    // The frame of a bin if it is in the report, else one with a picture within six pixels; -1: none.
    const target = (b) => {
      const own = byFrame.get(`${index} ${frame[b]}`);
      if (own !== undefined) return own;
      let best = -1, least = 6;
      place.forEach((p, k) => { const d = Math.abs(x(p) - x(b)); if (d <= least) { least = d; best = shots[k][1]; } });
      return best;
    };
    const move = (b) => {
      at = Math.max(0, Math.min(n - 1, b));
      cursor.setAttribute("x1", x(at)); cursor.setAttribute("x2", x(at));
      cursor.setAttribute("visibility", "visible");
      spot.setAttribute("visibility", nearest[at] === null ? "hidden" : "visible");
      if (nearest[at] !== null) { spot.setAttribute("cx", x(at)); spot.setAttribute("cy", y(nearest[at])); }
      const area = svg.getBoundingClientRect();
      const scale = area.width / W;
      showTip(area.left + x(at) * scale, area.top + (nearest[at] === null ? top + 20 : y(nearest[at])) * scale, say(at));
      svg.setAttribute("aria-valuetext", say(at));
    };
    const leave = () => { cursor.setAttribute("visibility", "hidden"); spot.setAttribute("visibility", "hidden"); hideTip(); };
    const open = () => { const f = target(at); if (f >= 0) { leave(); openFrame(f); } };
    svg.addEventListener("pointermove", (e) => {
      if (rests) return;
      const area = svg.getBoundingClientRect();
      const px = ((e.clientX - area.left) / area.width) * W;
      let best = 0;
      for (let b = 1; b < n; b++) if (Math.abs(x(b) - px) < Math.abs(x(best) - px)) best = b;
      move(best);
    });
    svg.addEventListener("pointerleave", leave);
    svg.addEventListener("blur", leave);
    svg.addEventListener("click", open);
    svg.addEventListener("keydown", (e) => {
      const by = { ArrowLeft: -1, ArrowRight: 1, PageUp: -20, PageDown: 20 }[e.key];
      if (by) { move((at < 0 ? 0 : at) + by); e.preventDefault(); }
      if (e.key === "Home") { move(0); e.preventDefault(); }
      if (e.key === "End") { move(n - 1); e.preventDefault(); }
      if (e.key === "Enter" && at >= 0) { open(); e.preventDefault(); }
      if (e.key === "Escape") leave();
    });
  }

  // ---- histogram
  let counted = "per_frame";
  function drawHistogram() {
    const node = clear($("histogram"));
    const first = picked().find((l) => l.per_frame);
    if (!first) { add(node, "p", {}, "No frames."); return; }
    const size = first.per_frame.length;
    const bins = Array.from({ length: size }, (_, b) => sum((l) => (l[counted] ? l[counted][b] : 0)));
    const total = bins.reduce((a, b) => a + b, 0), high = Math.max(...bins, 1);
    const W = Math.max(300, Math.min(620, node.clientWidth)), H = W < 400 ? 220 : 260, left = 46, right = W - 8, top = 10, bottom = H - 34;
    const what = counted === "per_frame" ? "frame" : "obstacle";
    const svg = add(node, "svg", { viewBox: `0 0 ${W} ${H}`, role: "img", "aria-label": `Histogram of distances of ${many(total, what)}` });
    for (const part of [0, 0.5, 1]) {
      const y = bottom - part * (bottom - top);
      add(svg, "line", { class: "rule", x1: left, x2: right, y1: y, y2: y });
      const value = part * high;
      if (Number.isInteger(value)) add(svg, "text", { x: left - 6, y: y + 4, "text-anchor": "end" }, value.toLocaleString("en"));
    }
    const wide = (right - left) / size;
    bins.forEach((n, b) => {
      const tall = (n / high) * (bottom - top);
      const range = b < size - 1 ? `${(b * data.width).toFixed(2)} to ${((b + 1) * data.width).toFixed(2)} m` : `${(b * data.width).toFixed(2)} m and more`;
      const bar = add(svg, "rect", { class: "barr", x: left + b * wide + 0.75, width: wide - 1.5, y: bottom - tall, height: tall });
      add(bar, "title", {}, `${range}: ${many(n, what)}`);
    });
    const every = Math.max(1, Math.round((size - 1) / (W < 400 ? 4 : 8)));
    for (let b = 0; b < size; b += every) add(svg, "text", { x: left + b * wide, y: bottom + 16, "text-anchor": "middle" }, `${+(b * data.width).toFixed(2)}`);
    add(svg, "text", { x: (left + right) / 2, y: H - 4, "text-anchor": "middle" }, counted === "per_frame" ? "distance to the nearest obstacle per frame [m]" : "distance of each obstacle [m]");
    const near = data.near.map((limit, i) => `${share(sum((l) => (l[counted] ? l[`near_${what}s`][i] : 0)), total)} nearer than ${limit} m`);
    if (total) add(node, "p", { class: "faint" }, `${many(total, what)}; ${near.join(", ")}.`);
  }

  function chips(node, items, get, set) {
    clear(node);
    for (const [value, text] of items) {
      const on = get() === value;
      const chip = add(node, "button", { type: "button", role: "radio", "aria-checked": String(on), tabindex: on ? "0" : "-1", "data-value": value }, text);
      chip.addEventListener("click", () => { set(value); chips(node, items, get, set); node.querySelector('[aria-checked="true"]').focus(); });
      chip.addEventListener("keydown", (e) => {
        const by = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[e.key];
        if (!by) return;
        const here = items.findIndex(([v]) => v === value);
        node.children[(here + by + items.length) % items.length].click();
        e.preventDefault();
      });
    }
  }

  // ---- maps
  function drawMaps() {
    const node = clear($("map"));
    const some = picked().filter((l) => l.map);
    $("map-section").hidden = !data.logs.some((l) => l.map);
    if (!some.length) {
      const left = picked().filter((l) => l.map_file).map((l) => `${l.map_file}.png`);
      add(node, "p", {}, left.length ? `This page does not include the map; it is ${left[0]} in the results.` : "No map, see the warnings and notes.");
      return;
    }
    for (const log of some.slice(0, only < 0 ? 4 : 1)) {
      const m = log.map, xs = m.path.filter((_, i) => i % 2 === 0), ys = m.path.filter((_, i) => i % 2);
      const low = [Math.min(m.x, ...xs), Math.min(m.y, ...ys)], high = [Math.max(m.x + m.width, ...xs), Math.max(m.y + m.height, ...ys)];
      const pad = 0.04 * Math.max(high[0] - low[0], high[1] - low[1]);
      const W = high[0] - low[0] + 2 * pad, H = high[1] - low[1] + 2 * pad, unit = Math.max(W, H) / 100;
      const X = (v) => v - low[0] + pad, Y = (v) => high[1] + pad - v;
      const figure = add(node, "figure");
      const svg = add(figure, "svg", { viewBox: `0 0 ${W} ${H}`, role: "img", "aria-label": `Map of ${log.log} from above, ${W.toFixed(1)} by ${H.toFixed(1)} m` });
      add(svg, "image", { href: m.picture, x: X(m.x), y: Y(m.y + m.height), width: m.width, height: m.height, preserveAspectRatio: "none" });
      if (xs.length) {
        add(svg, "polyline", { class: "path", "stroke-width": 0.6 * unit, points: xs.map((v, i) => `${X(v).toFixed(3)},${Y(ys[i]).toFixed(3)}`).join(" ") });
        add(svg, "circle", { cx: X(xs[0]), cy: Y(ys[0]), r: 1.1 * unit, class: "path", "stroke-width": 0.6 * unit });
      }
      const ways = shownTracks(log).filter((t) => t[8]);
      for (const t of ways) {
        const at = t[8].filter((_, i) => i % 2 === 0).map((v, i) => [X(v).toFixed(3), Y(t[8][2 * i + 1]).toFixed(3)]);
        const line = at.length > 1 ? add(svg, "polyline", { class: "way", "stroke-width": 0.5 * unit, points: at.map((p) => p.join(",")).join(" ") }) : null;
        const [x, y] = at[at.length - 1];
        const end = add(svg, "circle", { class: t[11] === false ? "way end new" : "way end", cx: x, cy: y, r: 0.8 * unit });
        for (const mark of line ? [line, end] : [end]) add(mark, "title", {}, `track ${t[0]}${t[11] === false ? ", new" : ""}`);
      }
      const scale = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000].find((s) => s > W / 8) || 1000;
      const bar = add(svg, "line", { class: "scale", x1: 3 * unit, x2: 3 * unit + scale, y1: H - 3 * unit, y2: H - 3 * unit, "stroke-width": 0.5 * unit });
      add(bar, "title", {}, `${scale} m`);
      const caption = add(figure, "figcaption", {}, `${data.logs.length > 1 ? log.log + ": " : ""}the bar is ${scale} m, cells are ${m.cell} m.`);
      for (const [kind, text] of [["covered", "covered by outlines"], ["free", "seen free"], ["path", "camera trajectory (ring: start)"], ...(ways.length ? [["way", "object trajectories (dot: end)"]] : []), ...(ways.some((t) => t[11] === false) ? [["new", "not in the known map"]] : [])]) {
        add(caption, "span", { class: `key ${kind}` });
        caption.append(text);
      }
    }
    if (only < 0 && some.length > 4) add(node, "p", { class: "faint" }, `${some.length - 4} further maps: choose a log above.`);
  }

  // ---- tracks
  let followed = data.logs.some((l) => l.tracks && l.tracks.moving) ? "moving" : "all";
  const shownTracks = (log) => (log.tracks ? log.tracks.rows.filter((t) => followed === "all" || (followed === "new" ? t[11] === false : t[1] === (followed === "moving"))) : []);
  const compared = data.logs.some((l) => l.tracks && l.tracks.new != null);
  const percent = (value) => (value == null ? "–" : `${Math.round(100 * value)} %`);
  function drawTracks() {
    $("track-section").hidden = !data.logs.some((l) => l.tracks);
    const rows = picked().flatMap((l) => shownTracks(l).map((t) => [
      ...(data.logs.length > 1 ? [l.log] : []), String(t[0]), t[1] ? "moves" : "stands", seconds(t[2]), seconds(t[3]),
      t[1] ? `${t[4].toFixed(2)} m/s` : "–", t[1] ? `${t[5].toFixed(2)} m/s` : "–", `${t[6].toFixed(2)} × ${t[7].toFixed(2)} m`,
      percent(t[9]), percent(t[10]), ...(compared ? [t[11] == null ? "–" : t[11] ? "has it" : "new"] : []),
    ]));
    table($("tracks"), [...(data.logs.length > 1 ? ["Log"] : []), "#Track", "Motion", "#Seen from", "#Seen for", "#Mean speed", "#Top speed", "#Size", "#Persistence", "#Floor seen", ...(compared ? ["Known map"] : [])], rows);
    const counts = { moving: (t) => t.moving, standing: (t) => t.standing, new: (t) => t.new || 0, all: (t) => t.moving + t.standing };
    const every = sum((l) => (l.tracks ? counts[followed](l.tracks) : 0));
    const notes = rows.length ? [] : ["None."];
    if (rows.length < every) notes.push(`${many(every - rows.length, "further track")} in tracks.parquet.`);
    if (picked().some((l) => shownTracks(l).some((t) => !t[8]))) notes.push("Without poses, motion is relative to the camera and includes the camera's own motion.");
    $("tracks-left").textContent = notes.join(" ");
  }

  // ---- gallery
  const KINDS = [["all", "All"], ["nearest", "Nearest"], ["most", "Most obstacles"], ["overflow", "Overflow"], ["lost", "Without a result"]];
  const NAMES = { nearest: "near", most: "many obstacles", overflow: "overflow", lost: "no result" };
  let kind = "all", order = "time", showing = [];

  const secondsOf = (f) => seconds(f.time);
  function line(f) {
    if (f.status !== "ok") return f.reason || data.reasons[f.status] || f.status;
    const near = f.nearest === null ? (f.count ? many(f.count, "obstacle") : "no obstacle") : `nearest ${metres(f.nearest)} · ${many(f.count, "obstacle")}`;
    return [near, f.drop !== null ? `drop at ${metres(f.drop)}` : ""].filter(Boolean).join(" · ");
  }
  const where = (f) => `${data.logs.length > 1 ? data.logs[f.log].log + " · " : ""}frame ${f.frame}`;

  const undrawn = () => {
    const [first, ...others] = data.undrawn;
    return `no pictures of some frames: ${first}${others.length ? `, and ${many(others.length, "further log")}` : ""}`;
  };

  function drawGallery() {
    const far = (v) => (v === null ? Infinity : v);
    const sorts = { time: (a, b) => a - b, nearest: (a, b) => far(data.frames[a].nearest) - far(data.frames[b].nearest) || a - b,
      most: (a, b) => data.frames[b].count - data.frames[a].count || a - b };
    showing = data.frames.map((_, i) => i)
      .filter((i) => (only < 0 || data.frames[i].log === only) && (kind === "all" || data.frames[i].kinds.includes(kind)))
      .sort(sorts[order]);
    const node = clear($("cards"));
    const bare = data.undrawn.length && showing.some((i) => data.frames[i].status === "ok" && !data.frames[i].picture);
    $("shown").textContent = showing.length ? `${many(showing.length, "frame")} of ${sum((l) => l.frames).toLocaleString("en")}${bare ? "; " + undrawn() : ""}` : kind === "all" ? "None: the run drew no frame, and none has an obstacle or is lost." : "No frame of this kind.";
    for (const i of showing) card(node, i);
  }

  // Outlines from above, for frames without a picture: right and forward of the camera.
  const begins = data.frames.flatMap((f) => f.outlines.map((o) => Math.min(o[1], o[3], o[5], o[7])));
  const radius = Math.min(8, Math.max(2, ...begins.map((m) => Math.ceil(m + 0.5))));
  function plan(parent, f) {
    const per = 240 / (radius + 0.2), X = (x) => 258 + x * per, Y = (y) => 244 - y * per;
    const scale = 516 / (parent.clientWidth || 340); // text is as large on the screen at any width
    const svg = add(parent, "svg", { class: "plan", viewBox: "0 0 516 248", "font-size": 11.5 * scale, role: "img", "aria-label": `Outlines of the obstacles in ${where(f)}, from above` });
    for (let m = 1; m <= radius; m++) {
      add(svg, "circle", { cx: X(0), cy: Y(0), r: m * per });
      add(svg, "text", { x: X(0) + 3, y: Y(m) - 3 }, `${m} m`);
    }
    add(svg, "path", { class: "eye", d: "M250 248L254 236H262L266 248Z" });
    f.outlines.forEach((o, i) => {
      const color = data.palette[f.rows[i][0] % data.palette.length];
      const points = [0, 2, 4, 6].map((k) => `${X(o[k]).toFixed(1)},${Y(o[k + 1]).toFixed(1)}`);
      add(svg, "polygon", { points: points.join(" "), fill: color, stroke: color });
    });
  }
  // A picture that a click or a tap shows in full size, to be scrolled in its frame.
  function zoomed(parent, f) {
    const frame = add(parent, "div", { class: "zoom" });
    const button = add(frame, "button", { type: "button", "aria-pressed": "false", "aria-label": "Enlarge the picture" });
    look(button, f);
    button.addEventListener("click", (e) => {
      const box = button.getBoundingClientRect(), px = (e.clientX - box.left) / box.width, py = (e.clientY - box.top) / box.height;
      const large = frame.classList.toggle("large");
      button.setAttribute("aria-pressed", String(large));
      if (large) {
        frame.scrollLeft = px * frame.scrollWidth - frame.clientWidth / 2;
        frame.scrollTop = py * frame.scrollHeight - frame.clientHeight / 2;
      }
    });
  }
  function look(parent, f) {
    if (f.picture) add(parent, "img", { src: f.picture, alt: `Obstacles found in ${where(f)}`, width: f.size[0], height: f.size[1] });
    else if (f.status === "ok") plan(parent, f);
  }

  function card(parent, index) {
    const f = data.frames[index];
    const node = add(parent, "button", { type: "button", class: "card", "data-frame": index });
    look(node, f);
    const text = add(node, "span", { class: "text" });
    add(text, "strong", {}, where(f));
    add(text, "span", { class: f.status === "ok" ? "faint" : "bad" }, `${secondsOf(f)} · ${line(f)}`);
    const tags = f.kinds.filter((k) => NAMES[k]);
    if (tags.length) add(text, "br");
    for (const k of tags) add(text, "span", { class: `tag ${k}` }, NAMES[k]);
    node.addEventListener("click", () => openFrame(index));
  }

  // ---- one frame
  const dialog = $("frame");
  let current = -1;
  function openFrame(index) {
    const f = data.frames[index], log = data.logs[f.log];
    current = index;
    $("frame-title").textContent = `${log.log} · frame ${f.frame}`;
    const body = clear($("frame-body"));
    if (!dialog.open) dialog.showModal();
    if (f.picture) zoomed(body, f);
    else look(body, f);
    const list = add(body, "dl", { class: "numbers" });
    const item = (name, value) => { if (value === null || value === "") return; const d = add(list, "div"); add(d, "dt", {}, name); add(d, "dd", {}, value); };
    item("time", secondsOf(f));
    item("status", f.status);
    item("obstacles", String(f.count));
    item("nearest", f.nearest === null ? null : metres(f.nearest));
    item("drop", f.drop === null ? null : metres(f.drop));
    item("camera", f.height === null ? null : `${f.height.toFixed(2)} m up, ${f.pitch.toFixed(1)}° down, roll ${f.roll.toFixed(1)}°`);
    item("floor from", data.sources[f.source] || f.source);
    item("overflow", f.kinds.includes("overflow") || f.overflow ? "yes" : null);
    item("stamp", f.stamp + " ns");
    if (f.reason || f.status !== "ok") add(body, "p", { class: "bad" }, f.reason || data.reasons[f.status] || f.status);
    else if (f.refused) add(body, "p", { class: "faint" }, `The floor found in the frame's own depth was refused: ${f.refused.replace("_", " ")}.`);
    if (f.rows.length) {
      const wide = add(body, "div", { class: "wide" });
      table(wide, ["obstacle", "#distance", "#bottom", "#top", "#width", "#depth", "#cells"],
        f.rows.map((r) => [obstacle(r[0]), ...r.slice(1, 6).map(metres), r[6]]));
      if (f.count > f.rows.length) add(body, "p", { class: "faint" }, `The nearest ${f.rows.length} of ${f.count}.`);
    }
    dialog.scrollTop = 0;
  }
  function step(by) {
    const here = showing.indexOf(current);
    if (showing.length) openFrame(showing[(here < 0 ? 0 : here + by + showing.length) % showing.length]);
  }
  $("before").addEventListener("click", () => step(-1));
  $("after").addEventListener("click", () => step(1));
  $("close").addEventListener("click", () => dialog.close());
  dialog.addEventListener("click", (e) => { if (e.target === dialog) dialog.close(); });
  dialog.addEventListener("keydown", (e) => {
    if (e.key === "ArrowLeft") step(-1);
    if (e.key === "ArrowRight") step(1);
  });
  dialog.addEventListener("close", () => {
    if (document.activeElement.closest(".timeline")) return; // it was opened from a timeline
    const origin = document.querySelector(`.card[data-frame="${current}"]`);
    if (origin) { origin.focus({ preventScroll: true }); origin.scrollIntoView({ block: "nearest", behavior: calm ? "auto" : "smooth" }); }
  });

  // ---- logs, configuration
  function drawLogs() {
    table($("logs"), ["Log", "Recorded", "#Length", "#Frames", "#Lost", "#Obstacles", "#Nearest", "#Overflow", "Floor from"],
      picked().map((l) => [l.log, date(l), l.duration === null ? "–" : seconds(l.duration), l.frames.toLocaleString("en"),
        l.error ? "failed" : (l.frames - (l.status.ok || 0)).toLocaleString("en"), l.obstacles.toLocaleString("en"),
        l.nearest ? metres(l.nearest[0]) : "–", l.overflow.toLocaleString("en"), l.floor]));
    const node = clear($("warnings"));
    for (const what of ["warning", "note"]) {
      const lines = picked().flatMap((l) => l[`${what}s`].map((w) => (data.logs.length > 1 ? `${l.log}: ${w}` : w)));
      if (!lines.length) continue;
      const open = what === "warning" && (lines.length < 6 || sum((l) => l.floorless));
      const more = add(node, "details", { open: open ? "" : null });
      add(more, "summary", {}, many(lines.length, what));
      const list = add(more, "ul");
      for (const text of lines.slice(0, 200)) add(list, "li", {}, text);
    }
  }
  function drawSettings() {
    const node = $("settings");
    if (data.settings.length) table(node, ["Setting", "Value", `Preset ${data.preset}`], data.settings);
    else add(node, "p", {}, `Default settings of preset ${data.preset}.`);
    table($("run"), ["Run", ""], data.run);
  }

  function drawAll() {
    drawn = STEP;
    for (const draw of [drawFigures, drawLost, drawTimelines, drawHistogram, drawMaps, drawTracks, drawGallery, drawLogs]) draw();
  }
  const select = $("only");
  add(select, "option", { value: "-1" }, `all ${data.logs.length}`);
  data.logs.forEach((log, i) => add(select, "option", { value: String(i) }, log.log));
  select.addEventListener("change", () => { only = Number(select.value); drawAll(); });
  $("only-label").hidden = data.logs.length < 2;
  $("order").addEventListener("change", (e) => { order = e.target.value; drawGallery(); });
  chips($("hist-of"), [["per_frame", "Nearest of each frame"], ["per_obstacle", "All obstacles"]], () => counted, (v) => { counted = v; drawHistogram(); });
  chips($("track-kinds"), [["moving", "Moving"], ["standing", "Standing"], ...(compared ? [["new", "New"]] : []), ["all", "All tracks"]], () => followed, (v) => { followed = v; drawTracks(); drawMaps(); });
  chips($("kinds"), KINDS.filter(([k]) => k === "all" || data.frames.some((f) => f.kinds.includes(k))), () => kind, (v) => { kind = v; drawGallery(); });
  $("about").textContent = data.about;
  drawSettings();
  drawAll();
  let width = innerWidth;
  addEventListener("resize", () => { if (innerWidth !== width) { width = innerWidth; drawTimelines(); drawHistogram(); drawGallery(); } });
})();
