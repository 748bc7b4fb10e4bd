// The keyboard, and printing.

const keys = [
  [["n"], "next failure", () => nextFailure(1)],
  [["p"], "previous failure", () => nextFailure(-1)],
  [["+", "="], "zoom in", () => zoom(0.5)],
  [["-"], "zoom out", () => zoom(2)],
  [["ArrowLeft"], "earlier", () => move(-0.25)],
  [["ArrowRight"], "later", () => move(0.25)],
  [["0", "Home"], "whole session", () => setRange(0, axis.whole)],
  [["f"], "show or hide what never failed", () => setFolds(!timeline.folds)],
  [["/"], "search in the log", () => byId("search").focus()],
  [["d"], "light or dark", otherTheme],
  [["?"], "these keys", () => byId("help").showModal()],
];

function startKeys() {
  const names = { ArrowLeft: "←", ArrowRight: "→" };
  fillTable(byId("keys"), [], keys.map(([pressed, text]) => [make("td", {}, ...pressed.map((key) => make("kbd", { text: names[key] ?? key }))), make("td", { text })]));
  byId("help-button").addEventListener("click", () => byId("help").showModal());
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || byId("help").open) return;
    if (event.target.matches("input, select, textarea")) {
      if (event.key === "Escape") event.target.blur();
      return;
    }
    const found = keys.find(([pressed]) => pressed.includes(event.key));
    if (!found) return;
    event.preventDefault();
    found[2]();
  });
}

// On paper all is light, every row is there, and the log is the part in sight.
function startPrinting() {
  let before = null;
  addEventListener("beforeprint", () => {
    before = { theme: document.documentElement.dataset.theme };
    byId("log-print").textContent = printedLog();
    setTheme("light");
    byId("rows").style.maxHeight = "none";
    drawNow();
  });
  addEventListener("afterprint", () => {
    setTheme(before.theme);
    byId("rows").style.maxHeight = "";
    drawNow();
  });
}
