// Colours of the canvases: read from the style once, and again when the theme changes.

const theme = { colours: null, listeners: [] };
const preference = matchMedia("(prefers-color-scheme: dark)");

function setTheme(name) {
  document.documentElement.dataset.theme = name;
  byId("theme").textContent = name === "dark" ? "Light" : "Dark";
  theme.colours = null;
  for (const listener of theme.listeners) listener();
}

function otherTheme() {
  setTheme(document.documentElement.dataset.theme === "dark" ? "light" : "dark");
}

function colours() {
  if (!theme.colours) {
    const style = getComputedStyle(document.documentElement);
    const read = (name) => style.getPropertyValue(`--${name}`).trim();
    theme.colours = {
      card: read("card"), text: read("text"), muted: read("muted"), line: read("line"), grid: read("grid"),
      accent: read("accent"), select: read("select"),
      states: ["constructing", "loaded", "crashed", "away"].map(read),
      density: read("density").split(",").map(Number),
      series: [0, 1, 2, 3, 4, 5].map((number) => read(`s${number}`)),
      sans: read("sans"),
    };
  }
  return theme.colours;
}

setTheme(preference.matches ? "dark" : "light");
preference.addEventListener("change", () => setTheme(preference.matches ? "dark" : "light"));
byId("theme").addEventListener("click", otherTheme);
