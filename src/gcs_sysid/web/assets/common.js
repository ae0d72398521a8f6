"use strict";
/* What both pages share: theme, elements, requests. */

const THEMES = ["auto", "light", "dark", "sun"];
const dark = matchMedia("(prefers-color-scheme: dark)");

function applyTheme(name) {
  const known = THEMES.includes(name) ? name : "auto";
  document.documentElement.dataset.theme = known !== "auto" ? known : dark.matches ? "dark" : "light";
  return known;
}

function storedTheme() {
  try { return localStorage.getItem("theme") || "auto"; } catch { return "auto"; }
}

applyTheme(storedTheme());
dark.addEventListener("change", () => applyTheme(storedTheme()));

/* The token has become a cookie; it need not stay in the address, the history or a screenshot. */
if (location.search) history.replaceState(null, "", location.pathname);

const SVG = "http://www.w3.org/2000/svg";
const byId = (id) => document.getElementById(id);

/* An element; text is text, never markup. */
function make(name, attributes = {}, ...children) {
  const svg = name.startsWith("svg:");
  const made = svg ? document.createElementNS(SVG, name.slice(4)) : document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (value === null || value === undefined || value === false) continue;
    if (key.startsWith("on")) made.addEventListener(key.slice(2), value);
    else made.setAttribute(key, value === true ? "" : value);
  }
  made.append(...children.filter((child) => child !== null && child !== undefined));
  return made;
}

/* Put children only where something differs, so that focus and selections stay. */
function fill(parent, ...children) { parent.replaceChildren(...children); }

function setText(element, text) { if (element.textContent !== text) element.textContent = text; }

function toggle(element, shown) { if (element.hidden === shown) element.hidden = !shown; }

async function lineOf(response) {
  const text = (await response.text()).trim().split("\n")[0];
  return text || `the server answered ${response.status}`;
}

/* JSON of an answer; throws the one line that says what is wrong. */
async function ask(path, options = {}) {
  let response;
  try { response = await fetch(path, options); } catch { throw new Error("gcs-sysid does not answer: has it ended?"); }
  if (!response.ok) throw new Error(await lineOf(response));
  return response.json();
}

const post = (path, document_, signal) => ({
  method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(document_), signal,
});

function setUpTheme() {
  const choice = byId("theme");
  choice.value = storedTheme();
  choice.addEventListener("change", () => {
    try { localStorage.setItem("theme", choice.value); } catch { /* a private window */ }
    applyTheme(choice.value);
  });
}

/* Cells that both pages show: a value with its unit, and a status with its sign. */
const valueCell = (row) => make("td", {}, make("span", { class: "value" }, `${row.value} ${row.half}`), " ", make("span", { class: "unit" }, row.unit));
const percentCell = (row) => make("td", { class: "number narrow-off" }, row.percent);
const statusCell = (row) => make("td", {}, make("span", { class: `status ${row.status}`, title: row.hint },
  make("span", { "aria-hidden": "true" }, row.sign), ` ${row.status}`));
