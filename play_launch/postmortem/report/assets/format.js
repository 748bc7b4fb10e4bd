// Numbers and times as people read them.

const units = [
  [3600000, 3600000], [1800000, 60000], [900000, 60000], [600000, 60000], [300000, 60000], [120000, 60000], [60000, 60000],
  [30000, 1000], [15000, 1000], [10000, 1000], [5000, 1000], [2000, 1000], [1000, 1000],
];

function pad(number, digits = 2) {
  return String(number).padStart(digits, "0");
}

// Milliseconds after the start as 1:02:03.456; `digits` of the fraction.
function clock(ms, digits = 3) {
  const factor = 10 ** digits;
  let rest = Math.round((Math.max(0, ms) / 1000) * factor);
  const fraction = rest % factor;
  rest = Math.floor(rest / factor);
  const seconds = rest % 60;
  const minutes = Math.floor(rest / 60) % 60;
  const hours = Math.floor(rest / 3600);
  const head = hours ? `${hours}:${pad(minutes)}` : `${minutes}`;
  return `${head}:${pad(seconds)}${digits ? `.${pad(fraction, digits)}` : ""}`;
}

function span(ms) {
  if (ms < 1000) return `${+ms.toFixed(ms < 10 ? 1 : 0)} ms`;
  if (ms < 60000) return `${+(ms / 1000).toFixed(ms < 10000 ? 2 : 1)} s`;
  const seconds = Math.round(ms / 1000);
  const minutes = Math.floor(seconds / 60);
  if (minutes < 60) return seconds % 60 ? `${minutes} min ${seconds % 60} s` : `${minutes} min`;
  return minutes % 60 ? `${Math.floor(minutes / 60)} h ${minutes % 60} min` : `${minutes / 60} h`;
}

function wallClock(ms) {
  const date = new Date(facts.started_ms + ms);
  return `${date.getFullYear()}-${pad(date.getMonth() + 1)}-${pad(date.getDate())} ${pad(date.getHours())}:${pad(date.getMinutes())}:${pad(date.getSeconds())}`;
}

// A time as typed: 75, 1:15, 1:02:03.5 or 75s; null for anything else.
function parseClock(text) {
  const match = /^\s*(?:(?:(\d+):)?(\d+):)?(\d+(?:\.\d+)?)\s*s?\s*$/.exec(text);
  if (!match) return null;
  return ((+(match[1] || 0) * 60 + +(match[2] || 0)) * 60 + +match[3]) * 1000;
}

function bytes(number) {
  const names = ["B", "kB", "MB", "GB", "TB"];
  let at = 0;
  while (number >= 1000 && at < names.length - 1) {
    number /= 1000;
    at++;
  }
  return `${+number.toFixed(number < 10 && at ? 1 : 0)} ${names[at]}`;
}

function percent(number) {
  return `${+number.toFixed(number < 10 ? 1 : 0)} %`;
}

function counted(number, one, many = `${one}s`) {
  return `${number.toLocaleString("en")} ${number === 1 ? one : many}`;
}

// A round step for about `count` parts of a range of plain numbers.
function niceStep(range, count) {
  const raw = range / count;
  const power = 10 ** Math.floor(Math.log10(raw));
  return [1, 2, 5, 10].map((each) => each * power).find((each) => each >= raw);
}

// A round step of time in milliseconds, and how many digits its labels need.
function timeStep(range, count) {
  const raw = range / count;
  if (raw > 3600000) return { step: 3600000 * niceStep(raw / 3600000, 1), digits: 0 };
  if (raw > 500) return { step: [...units].reverse().map((each) => each[0]).find((each) => each >= raw) ?? 3600000, digits: 0 };
  const step = niceStep(raw, 1);
  return { step, digits: step >= 100 ? 1 : step >= 10 ? 2 : 3 };
}

// An element with text and children; text is never markup.
function make(tag, options = {}, ...children) {
  const made = document.createElement(tag);
  const { text, className, ...rest } = options;
  if (text !== undefined) made.textContent = text;
  if (className) made.className = className;
  for (const [name, value] of Object.entries(rest)) made.setAttribute(name, value);
  made.append(...children);
  return made;
}

function byId(id) {
  return document.getElementById(id);
}

function rowName(row) {
  return facts.rows[row]?.name ?? "play-launch";
}
