"use strict";
(() => {
  const runs = JSON.parse(document.getElementById("data").textContent).runs;
  const $ = (id) => document.getElementById(id);
  if (!runs.length) return;
  document.documentElement.classList.add("scripted");
  $("player").hidden = false;
  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;
  for (const run of runs) {
    run.cells = new Uint32Array(bytes(run.cells));
    run.points = new Float32Array(bytes(run.points));
    run.motion = new Int16Array(bytes(run.motion));
    for (const colour of run.colours) colour.data = new Uint8Array(bytes(colour.data));
  }
  const canvas = $("canvas"), ramp = $("ramp"), slider = $("frame");
  let run = runs[0], colour, palette, timer = 0, last = 0;

  const option = (list, words, chosen) => {
    list.replaceChildren(...words.map((text, k) => new Option(text, k, k === chosen, k === chosen)));
  };
  const mixed = (stops, share) => {
    const place = share * (stops.length - 1), k = Math.min(Math.floor(place), stops.length - 2);
    const at = (stop, i) => parseInt(stop.slice(i, i + 2), 16);
    const part = (i) => Math.round(at(stops[k], i) + (place - k) * (at(stops[k + 1], i) - at(stops[k], i)));
    return `rgb(${part(1)},${part(3)},${part(5)})`;
  };
  const sized = (element) => {
    const ratio = window.devicePixelRatio || 1;
    const width = Math.round(element.clientWidth * ratio), height = Math.round(element.clientHeight * ratio);
    if (element.width !== width || element.height !== height) [element.width, element.height] = [width, height];
    return element.getContext("2d");
  };

  function choose() {
    run = runs[+$("which").value || 0];
    const before = colour ? colour.name : "von Mises stress";
    const k = Math.max(0, run.colours.findIndex((each) => each.name === before));
    option($("colour"), run.colours.map((each) => each.name), k);
    option($("factor"), run.factors.map((each) => `× ${each}`), run.factors.indexOf(run.factor));
    canvas.style.aspectRatio = (run.box[2] - run.box[0]) / (run.box[3] - run.box[1]);
    slider.max = run.t.length - 1;
    slider.value = Math.min(+slider.value, run.t.length - 1);
    paint();
  }

  function paint() {
    colour = run.colours[+$("colour").value];
    palette = new Array(256).fill("#9a9a9a");
    const listed = $("sources");
    listed.hidden = !colour.sources;
    document.querySelector(".scale").hidden = Boolean(colour.sources);
    if (colour.sources) {
      listed.replaceChildren(...Object.entries(colour.sources).map(([code, [words, paintedIn]]) => {
        palette[code] = paintedIn;
        const entry = document.createElement("li"), mark = document.createElement("span");
        mark.className = "mark";
        mark.style.background = paintedIn;
        entry.append(mark, words);
        return entry;
      }));
    } else {
      for (let k = 0; k <= run.levels; k++) palette[k] = mixed(colour.stops, k / run.levels);
      [$("low").textContent, $("high").textContent] = colour.ends;
      const context = sized(ramp);
      for (let k = 0; k < ramp.width; k++) {
        context.fillStyle = mixed(colour.stops, k / Math.max(1, ramp.width - 1));
        context.fillRect(k, 0, 1, ramp.height);
      }
    }
    draw();
  }

  function draw() {
    const k = +slider.value, factor = run.factors[+$("factor").value];
    const context = sized(canvas), [x0, y0, x1, y1] = run.box, edge = 10;
    // below the tissue there is room for the scale bar
    const ratio = window.devicePixelRatio || 1, foot = 34 * ratio;
    const scale = Math.min((canvas.width - 2 * edge) / (x1 - x0), (canvas.height - 2 * edge - foot) / (y1 - y0));
    const left = (canvas.width - scale * (x1 - x0)) / 2, bottom = (canvas.height - foot + scale * (y1 - y0)) / 2;
    const count = run.points.length / 2, unit = factor * run.largest / 32767;
    const x = new Float32Array(count), y = new Float32Array(count);
    for (let n = 0; n < count; n++) {
      const at = 2 * (k * count + n);
      x[n] = left + scale * (run.points[2 * n] + unit * run.motion[at] - x0);
      y[n] = bottom - scale * (run.points[2 * n + 1] + unit * run.motion[at + 1] - y0);
    }
    context.clearRect(0, 0, canvas.width, canvas.height);
    context.lineWidth = 1.5;
    context.fillStyle = "rgba(128,128,128,.3)";
    context.strokeStyle = "#808080";
    for (const body of run.bodies) {
      const [dx, dy] = body.moved[k];
      context.beginPath();
      for (const [px, py] of body.outline) context.lineTo(left + scale * (px + factor * dx - x0), bottom - scale * (py + factor * dy - y0));
      context.closePath();
      context.fill();
      context.stroke();
    }
    const corners = run.corners, cells = run.cells.length / corners;
    context.lineWidth = corners > 2 ? (cells > 2000 ? 0 : 1) : 1.5;
    for (let e = 0; e < cells; e++) {
      context.beginPath();
      for (let c = 0; c < corners; c++) {
        const n = run.cells[e * corners + c];
        c ? context.lineTo(x[n], y[n]) : context.moveTo(x[n], y[n]);
      }
      const level = palette[colour.data[k * cells + e]];
      if (corners > 2) {
        context.closePath();
        context.fillStyle = level;
        context.fill();
        context.strokeStyle = cells > 2000 ? level : "rgba(128,128,128,.7)";
      } else context.strokeStyle = level;
      context.stroke();
    }
    // supports stand still, grips move as wholes
    context.lineCap = "round";
    for (const [a, b, still] of run.held) {
      context.lineWidth = (still ? 5 : 3) * ratio;
      context.strokeStyle = getComputedStyle(canvas).color;
      context.beginPath();
      context.moveTo(x[a], y[a]);
      context.lineTo(x[b], y[b]);
      context.stroke();
    }
    context.lineCap = "butt";
    context.lineWidth = 1.5 * ratio;
    context.strokeStyle = context.fillStyle = getComputedStyle(canvas).color;
    for (const [n, begin, end] of run.arrows) {
      const [ax, ay, bx, by] = [x[n] + scale * begin[0], y[n] - scale * begin[1], x[n] + scale * end[0], y[n] - scale * end[1]];
      const angle = Math.atan2(by - ay, bx - ax), head = 8 * ratio;
      context.beginPath();
      context.moveTo(ax, ay);
      context.lineTo(bx - 0.8 * head * Math.cos(angle), by - 0.8 * head * Math.sin(angle));
      context.stroke();
      context.beginPath();
      context.moveTo(bx, by);
      for (const turn of [-0.4, 0.4]) context.lineTo(bx - head * Math.cos(angle + turn), by - head * Math.sin(angle + turn));
      context.closePath();
      context.fill();
    }
    const [length, words] = run.bar, under = bottom + 14 * ratio;
    context.lineWidth = 3 * ratio;
    context.beginPath();
    context.moveTo(left, under);
    context.lineTo(left + scale * length, under);
    context.stroke();
    context.font = `${12 * ratio}px sans-serif`;
    context.fillText(words, left, under + 15 * ratio);
    $("clock").textContent = `${run.clock[0]}${run.t[k].toPrecision(4)}${run.clock[1]}`;
    slider.setAttribute("aria-valuetext", $("clock").textContent);
    canvas.setAttribute("aria-label", `${run.name}, ${colour.name}, ${$("clock").textContent}`);
  }

  function go(k) {
    slider.value = Math.max(0, Math.min(run.t.length - 1, k));
    draw();
  }
  function play(on) {
    cancelAnimationFrame(timer);
    timer = 0;
    $("play").textContent = on ? "Pause" : "Play";
    $("play").setAttribute("aria-pressed", String(on));
    if (!on) return;
    if (+slider.value >= run.t.length - 1) slider.value = 0;
    last = performance.now();
    const pace = Math.max(40, 8000 / run.t.length);
    const next = (now) => {
      if (now - last >= pace) {
        last = now;
        if (+slider.value >= run.t.length - 1) return play(false);
        go(+slider.value + 1);
      }
      timer = requestAnimationFrame(next);
    };
    timer = requestAnimationFrame(next);
  }
  $("play").addEventListener("click", () => play(!timer));
  slider.addEventListener("input", () => { play(false); draw(); });
  canvas.addEventListener("keydown", (event) => {
    const to = { ArrowLeft: +slider.value - 1, ArrowRight: +slider.value + 1, Home: 0, End: run.t.length - 1 }[event.key];
    if (event.key === " ") play(!timer);
    else if (to !== undefined) { play(false); go(to); }
    else return;
    event.preventDefault();
  });
  $("which").addEventListener("change", () => { play(false); choose(); });
  $("colour").addEventListener("change", paint);
  $("factor").addEventListener("change", draw);
  window.addEventListener("resize", paint);
  option($("which"), runs.map((each) => each.name), 0);
  const farthest = (r) => {
    const count = r.points.length, frames = r.t.length, size = new Float32Array(frames);
    for (let k = 0; k < frames; k++)
      for (let n = 0; n < count; n++) size[k] = Math.max(size[k], Math.abs(r.motion[k * count + n]));
    return size.indexOf(Math.max(...size));
  };
  choose();
  go(farthest(run));
})();
