// The time that all plots show, and how it is changed with a mouse.

const labelWidth = 200;
const rightMargin = 8;
const shortest = 20; // milliseconds
const axis = { begin: 0, end: 1, whole: Math.max(facts.end, 1), listeners: [], cursor: null, row: -1, waiting: false, drag: null };
axis.end = axis.whole;

// Everything is drawn in the next frame, once.
function redraw() {
  if (axis.waiting) return;
  axis.waiting = true;
  requestAnimationFrame(drawNow);
}

function drawNow() {
  axis.waiting = false;
  for (const listener of axis.listeners) listener();
}

function setRange(begin, end) {
  const width = Math.min(Math.max(end - begin, shortest), axis.whole);
  const first = Math.min(Math.max((begin + end - width) / 2, 0), axis.whole - width);
  axis.begin = first;
  axis.end = first + width;
  redraw();
}

function zoom(factor, around = (axis.begin + axis.end) / 2) {
  setRange(around - (around - axis.begin) * factor, around + (axis.end - around) * factor);
}

function move(part) {
  const step = (axis.end - axis.begin) * part;
  setRange(axis.begin + step, axis.end + step);
}

// Shows a moment, closer than before if nearly everything is shown.
function showMoment(at) {
  const width = Math.min(axis.end - axis.begin, Math.max(120000, axis.whole / 30));
  setRange(at - width / 2, at + width / 2);
}

function plotWidth(canvas) {
  return Math.max(10, canvas.clientWidth - labelWidth - rightMargin);
}

function xOf(at, width) {
  return labelWidth + ((at - axis.begin) * width) / (axis.end - axis.begin);
}

function timeAt(canvas, clientX) {
  const x = clientX - canvas.getBoundingClientRect().left - labelWidth;
  return axis.begin + (x * (axis.end - axis.begin)) / plotWidth(canvas);
}

// The canvas at the size of its place, and its context in CSS pixels.
function prepared(canvas, height) {
  const ratio = devicePixelRatio || 1;
  const width = canvas.clientWidth;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
    canvas.style.height = `${height}px`;
  }
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  canvas.dataset.range = `${axis.begin} ${axis.end}`;
  return pen;
}

function ticks(width) {
  const { step, digits } = timeStep(axis.end - axis.begin, Math.max(2, width / 110));
  const found = [];
  for (let at = Math.ceil(axis.begin / step) * step; at <= axis.end; at += step) found.push(at);
  return { at: found, digits };
}

function drawGrid(pen, width, height) {
  pen.fillStyle = colours().grid;
  for (const at of ticks(width).at) pen.fillRect(Math.round(xOf(at, width)), 0, 1, height);
}

// What lies over every plot: the part being dragged over, and where the mouse is.
function drawOver(pen, width, height) {
  if (axis.drag?.kind === "select") {
    const [one, two] = [xOf(axis.drag.from, width), xOf(axis.drag.to, width)];
    pen.globalAlpha = 0.18;
    pen.fillStyle = colours().accent;
    pen.fillRect(Math.min(one, two), 0, Math.abs(two - one), height);
    pen.globalAlpha = 1;
  }
  if (axis.cursor !== null && axis.cursor >= axis.begin && axis.cursor <= axis.end) {
    pen.fillStyle = colours().muted;
    pen.fillRect(Math.round(xOf(axis.cursor, width)), 0, 1, height);
  }
}

function drawAxis() {
  const canvas = byId("axis");
  const pen = prepared(canvas, 22);
  const width = plotWidth(canvas);
  const { at, digits } = ticks(width);
  pen.font = `11px ${colours().sans}`;
  pen.fillStyle = colours().muted;
  pen.textAlign = "center";
  for (const each of at) {
    const x = Math.round(xOf(each, width));
    pen.fillRect(x, 17, 1, 5);
    pen.fillText(clock(each, digits), Math.min(Math.max(x, labelWidth + 14), labelWidth + width - 14), 12);
  }
  const digitsOfRange = axis.end - axis.begin < 10000 ? 3 : 1;
  byId("range").textContent =
    `${clock(axis.begin, digitsOfRange)} to ${clock(axis.end, digitsOfRange)} (${span(axis.end - axis.begin)})`;
}

function isOverPlot(canvas, event) {
  return event.clientX - canvas.getBoundingClientRect().left >= labelWidth;
}

// Drag selects, Shift-drag moves, Ctrl-wheel zooms, a sideways wheel moves.
function followMouse(canvas, clicked) {
  canvas.addEventListener("wheel", (event) => {
    const sideways = event.shiftKey ? event.deltaX || event.deltaY : Math.abs(event.deltaX) > Math.abs(event.deltaY) ? event.deltaX : 0;
    if (event.ctrlKey || event.metaKey) zoom(Math.exp(event.deltaY * 0.003), timeAt(canvas, event.clientX));
    else if (sideways) move(sideways / 800);
    else return;
    event.preventDefault();
  }, { passive: false });
  canvas.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    canvas.setPointerCapture(event.pointerId);
    const at = timeAt(canvas, event.clientX);
    const kind = !isOverPlot(canvas, event) ? "none" : event.shiftKey ? "move" : "select";
    axis.drag = { kind, from: at, to: at, x: event.clientX, begin: axis.begin, end: axis.end };
  });
  canvas.addEventListener("pointermove", (event) => {
    axis.cursor = isOverPlot(canvas, event) ? timeAt(canvas, event.clientX) : null;
    if (axis.drag?.kind === "select") axis.drag.to = Math.min(Math.max(axis.cursor ?? axis.begin, axis.begin), axis.end);
    if (axis.drag?.kind === "move") {
      const step = ((axis.drag.x - event.clientX) * (axis.drag.end - axis.drag.begin)) / plotWidth(canvas);
      setRange(axis.drag.begin + step, axis.drag.end + step);
    }
    redraw();
  });
  canvas.addEventListener("pointerup", (event) => {
    const drag = axis.drag;
    axis.drag = null;
    if (!drag) return;
    if (Math.abs(event.clientX - drag.x) < 4) clicked(event);
    else if (drag.kind === "select") setRange(Math.min(drag.from, drag.to), Math.max(drag.from, drag.to));
    redraw();
  });
  canvas.addEventListener("pointercancel", () => { axis.drag = null; });
  canvas.addEventListener("pointerleave", () => {
    axis.cursor = null;
    hideTip();
    redraw();
  });
  canvas.addEventListener("dblclick", () => setRange(0, axis.whole));
}

function showTip(event, text) {
  const tip = byId("tip");
  const card = byId("timeline-card").getBoundingClientRect();
  tip.textContent = text;
  tip.hidden = false;
  const left = event.clientX - card.left + 14;
  tip.style.left = `${Math.max(4, Math.min(left, card.width - tip.offsetWidth - 6))}px`;
  tip.style.top = `${event.clientY - card.top + 14}px`;
}

function hideTip() {
  byId("tip").hidden = true;
}

axis.listeners.push(drawAxis);
theme.listeners.push(redraw);
followMouse(byId("axis"), () => {});
