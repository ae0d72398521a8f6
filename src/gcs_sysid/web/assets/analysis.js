"use strict";
/* Drop a log, check the airframe, read the report; compare two results. */

let current = null; // the log in hand: {id, name}
let told = null; // the airframe that it proposes
let kindBefore = "builtin"; // of airframe: whose rotors a drawing begins with
let builtins = [];
let rotors = []; // drawn ones: {x, y, spin}
let toml = null;
let running = null; // AbortController of what is under way

function problem(text) {
  setText(byId("problem"), text || "");
  toggle(byId("problem"), Boolean(text));
  if (text) byId("problem").scrollIntoView({ block: "nearest" });
}

/* --- uploads */

/* XMLHttpRequest, since fetch tells nothing of the progress of an upload. */
function upload(file) {
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    request.open("PUT", `/items?name=${encodeURIComponent(file.name)}`);
    request.upload.onprogress = (event) => { if (event.lengthComputable) byId("upload-bar").value = event.loaded / event.total; };
    request.onerror = () => reject(new Error(`${file.name}: the upload failed (too large, or gcs-sysid has ended)`));
    request.onload = () => request.status === 200
      ? resolve(JSON.parse(request.responseText)) : reject(new Error(request.responseText.trim().split("\n")[0]));
    request.send(file);
  });
}

async function take(files) {
  problem("");
  for (const file of files) {
    setText(byId("upload-text"), `Uploading ${file.name} ...`);
    byId("upload-bar").value = 0;
    toggle(byId("upload"), true);
    try {
      const item = await upload(file);
      if (item.kind === "log") await look(item);
      else await show(item.id);
    } catch (error) { problem(error.message); }
    toggle(byId("upload"), false);
    await listItems();
  }
}

/* Lines of JSON as they come; the last has `done`. Leaving the page, or Cancel, ends the work. */
async function follow(path, document_, onProgress) {
  running = new AbortController();
  try {
    const response = await fetch(path, post(path, document_, running.signal)).catch((error) => {
      throw error.name === "AbortError" ? error : new Error("gcs-sysid does not answer: has it ended?");
    });
    if (!response.ok) throw new Error(await lineOf(response));
    const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
    let rest = "";
    for (;;) {
      const { value, done } = await reader.read();
      if (done) throw new Error("the analysis broke off");
      const lines = (rest + value).split("\n");
      rest = lines.pop();
      for (const line of lines) {
        const said = JSON.parse(line);
        if (said.error) throw new Error(said.error);
        if (said.done) return said.done;
        onProgress(said);
      }
    }
  } finally { running = null; }
}

async function look(item) {
  setText(byId("upload-text"), `Reading ${item.name} ...`);
  byId("upload-bar").removeAttribute("value");
  const found = await follow(`/items/${item.id}/look`, {}, (said) => { byId("upload-bar").value = said.progress; });
  current = item;
  told = found.airframe;
  sayAnswer("answer-line", "answer-action", found.answer);
  fill(byId("facts"), ...found.facts.flatMap(([name, text]) => [make("dt", {}, name), make("dd", {}, text)]));
  toggle(byId("answer"), true);
  const seconds = Math.round(found.duration);
  setText(byId("about-log"), `${item.name}: ${found.vehicle || "no autopilot found"}, ${seconds} s`);
  toggle(byId("from-log"), Boolean(told));
  setText(byId("log-words"), told ? told.words : "");
  const kind = document.querySelector(`input[value="${told ? "log" : "builtin"}"]`);
  kind.checked = true;
  byId("builtin").value = found.suggestion || "";
  toggle(byId("setup"), true);
  toggle(byId("result"), false);
  showKind();
  byId("scale").focus();
}

/* Whether the vehicle is all right, and what to do first. */
function sayAnswer(line, action, answer) {
  const word = { OK: "identified", "LOOK AT": "refused" }[answer && answer.word] || "partial";
  fill(byId(line), make("span", { class: word }, answer ? answer.line : ""));
  setText(byId(action), answer ? answer.action : "");
}

/* --- the airframe */

const chosenKind = () => document.querySelector("input[name=kind]:checked").value;

function showKind() {
  const kind = chosenKind();
  toggle(byId("builtin-choice"), kind === "builtin");
  toggle(byId("file-choice"), kind === "file");
  toggle(byId("drawing"), kind === "rotors");
  if (kind === "rotors" && !rotors.length) rotors = shownRotors(kindBefore).map(({ x, y, spin }) => ({ x, y, spin }));
  kindBefore = kind;
  draw();
}

function shownRotors(kind) {
  if (kind === "log") return told ? told.rotors : [];
  if (kind === "rotors") return rotors;
  if (kind === "file") return [];
  const found = builtins.find((one) => one.name === byId("builtin").value);
  return found ? found.rotors : [];
}

function sizeHint(kind) {
  if (kind === "log") return told && told.arm ? `${told.arm.toPrecision(3)} m from the log; enter another to override` : "needed: the log has no lengths";
  if (kind === "builtin") return (builtins.find((one) => one.name === byId("builtin").value) || {}).arm ? "optional" : "center to motor, such as 0.25 or 0.25±0.003";
  return kind === "rotors" ? "optional: scales the picture" : "optional: as the file says";
}

function draw() {
  const kind = chosenKind();
  const shown = shownRotors(kind);
  const reach = Math.max(0.05, ...shown.map((r) => Math.hypot(r.x, r.y))) || 0.25;
  setText(byId("arm-hint"), sizeHint(kind));
  const drawing = kind === "rotors";
  const picture = make("svg:svg", {
    viewBox: "-1.35 -1.35 2.7 2.7", class: drawing ? "plan drawing" : "plan", role: drawing ? "group" : "img",
    "aria-label": shown.length ? shown.map((r, i) => `motor ${i + 1} ${r.x.toFixed(2)} m forward, ${r.y.toFixed(2)} m right, ${r.spin}`).join("; ") : "no rotors yet",
  });
  picture.append(make("svg:path", { class: "nose", d: "M0 -1.3 l.07 .14 h-.14 z" }));
  for (const rotor of shown) picture.append(make("svg:line", { class: "arm", x1: 0, y1: 0, x2: rotor.y / reach, y2: -rotor.x / reach }));
  shown.forEach((rotor, i) => {
    const flip = (event) => { event.stopPropagation(); rotor.spin = rotor.spin === "cw" ? "ccw" : "cw"; drawAgain(i); };
    const group = make("svg:g", drawing ? {
      role: "button", tabindex: 0, "aria-label": `Motor ${i + 1}, ${rotor.spin}: change its spin`, onclick: flip,
      onkeydown: (event) => { if (event.key === "Enter" || event.key === " ") { event.preventDefault(); flip(event); } },
    } : {});
    const [u, v] = [rotor.y / reach, -rotor.x / reach];
    group.append(make("svg:circle", { class: `rotor ${rotor.spin}`, cx: u, cy: v, r: 0.26 }),
      make("svg:text", { x: u, y: v - 0.01 }, String(i + 1)),
      make("svg:text", { class: "spin", x: u, y: v + 0.12 }, rotor.spin === "cw" ? "↻ cw" : "↺ ccw"));
    picture.append(group);
  });
  if (drawing) picture.addEventListener("click", (event) => {
    const box = picture.getBoundingClientRect();
    const at = (share) => Math.round((share * 2.7 - 1.35) * 20) / 20 * reach;
    addRotor(-at((event.clientY - box.top) / box.height), at((event.clientX - box.left) / box.width));
  });
  fill(byId("picture"), picture);
  if (drawing) fill(byId("rotor-rows"), ...rotors.map(rotorRow));
}

function drawAgain(focused) {
  draw();
  const group = byId("picture").querySelectorAll("[role=button]")[focused];
  if (group) group.focus();
}

function rotorRow(rotor, i) {
  const number = (key, what) => make("td", {}, make("input", {
    type: "number", step: "any", value: Number(rotor[key].toFixed(4)), "aria-label": `Motor ${i + 1}, m ${what}`,
    onchange: (event) => { if (event.target.value !== "") { rotor[key] = Number(event.target.value); draw(); } },
  }));
  const spin = make("select", { "aria-label": `Motor ${i + 1}, spin`, onchange: (event) => { rotor.spin = event.target.value; draw(); } },
    ...["ccw", "cw"].map((way) => make("option", { value: way, selected: way === rotor.spin }, way)));
  return make("tr", {}, make("th", { scope: "row" }, String(i + 1)), number("x", "forward"), number("y", "right"), make("td", {}, spin));
}

function addRotor(x, y) {
  if (rotors.length >= 32) return;
  rotors.push({ x, y, spin: rotors.length && rotors.at(-1).spin === "cw" ? "ccw" : "cw" });
  draw();
}

/* --- the analysis */

async function identify(event) {
  event.preventDefault();
  problem("");
  const kind = chosenKind();
  const airframe = { kind };
  if (kind === "builtin") {
    airframe.name = byId("builtin").value;
    if (!airframe.name) return problem("choose a layout first");
  }
  if (kind === "rotors") airframe.rotors = rotors;
  if (kind === "file") {
    if (!toml) return problem("choose an airframe file first");
    Object.assign(airframe, toml);
  }
  const scale = byId("scale").value.trim().replace(",", ".");
  const request = { airframe, arm: byId("arm").value.trim().replace(",", ".") || null,
    scale: scale ? { name: byId("scale-name").value, value: scale } : null };
  byId("identify").disabled = true;
  toggle(byId("cancel"), true);
  toggle(byId("work"), true);
  try {
    await follow(`/items/${current.id}/analysis`, request, (said) => {
      byId("work-bar").value = said.progress;
      setText(byId("work-text"), `${said.stage} ...`);
    });
    await show(current.id);
    await listItems();
  } catch (error) {
    problem(error.name === "AbortError" ? "Cancelled." : error.message);
  } finally {
    byId("identify").disabled = false;
    toggle(byId("cancel"), false);
    toggle(byId("work"), false);
  }
}

async function show(id) {
  const found = await ask(`/items/${id}/result`);
  const { verdict } = found;
  setText(byId("result-title"), `3. Result: ${found.name}`);
  sayAnswer("result-answer", "result-action", found.answer);
  fill(byId("verdict"), make("span", { class: verdict.word, "aria-hidden": "true" }, verdict.sign), make("span", { class: verdict.word }, verdict.meaning));
  setText(byId("sentence"), verdict.sentence);
  fill(byId("reasons"), ...verdict.reasons.map((reason) => make("li", {}, reason)));
  fill(byId("parameters"), ...found.parameters.map((row) => make("tr", {},
    make("th", { scope: "row" }, row.name, make("span", { class: "meaning" }, row.meaning)),
    valueCell(row), percentCell(row), statusCell(row))));
  const links = [make("a", { class: "button", href: `/items/${id}/result.json`, download: "" }, "Save the result (JSON)")];
  if (found.report) links.unshift(make("a", { class: "button main", href: `/items/${id}/report.html`, target: "_blank", rel: "noopener" }, "Open the report"));
  fill(byId("downloads"), ...links);
  toggle(byId("health"), found.health);
  if (found.health) byId("health-picture").src = `/items/${id}/health.svg?${found.run}`;
  toggle(byId("report-box"), found.report);
  if (found.report) byId("report").src = `/items/${id}/report.html?${found.run}`;
  toggle(byId("result"), true);
  byId("result").focus({ preventScroll: true });
  byId("result").scrollIntoView({ block: "start" });
}

/* --- results and their comparison */

async function listItems() {
  const items = await ask("/items");
  const finished = items.filter((item) => item.analyzed);
  toggle(byId("results"), finished.length > 0);
  fill(byId("items"), ...finished.map((item) => make("li", {}, make("span", {}, item.name), make("span", { class: "buttons" },
    make("button", { type: "button", "aria-label": `Show ${item.name}`, onclick: () => show(item.id).catch((error) => problem(error.message)) }, "Show"),
    make("button", { type: "button", "aria-label": `Remove ${item.name}`, onclick: () => remove(item) }, "Remove")))));
  toggle(byId("compare"), finished.length > 1);
  ["before", "after"].forEach((name, place) => {
    const kept = byId(name).value;
    fill(byId(name), ...finished.map((item) => make("option", { value: item.id }, item.name)));
    byId(name).value = finished.some((item) => item.id === kept) ? kept : (finished[Math.min(place, finished.length - 1)] || { id: "" }).id;
  });
}

async function remove(item) {
  try {
    await ask(`/items/${item.id}`, { method: "DELETE" });
    if (current && current.id === item.id) { toggle(byId("result"), false); toggle(byId("setup"), false); }
    await listItems();
  } catch (error) { problem(error.message); }
}

async function compareResults(event) {
  event.preventDefault();
  problem("");
  try {
    const found = await ask(`/comparison?before=${byId("before").value}&after=${byId("after").value}`);
    setText(byId("comparison-text"), `${found.sign} ${found.sentence}`);
    setText(byId("comparison-caption"), `${found.before} and ${found.after}, values with 95 % intervals`);
    fill(byId("differences"), ...found.rows.map((row) => make("tr", {}, make("th", { scope: "row" }, row.name),
      make("td", {}, row.before), make("td", {}, row.after),
      make("td", {}, row.difference), make("td", {}, `${row.sign} ${row.verdict}${row.why ? `: ${row.why}` : ""}`))));
    fill(byId("notes"), ...found.notes.map((note) => make("li", {}, note)));
    toggle(byId("comparison"), true);
    byId("comparison").focus();
  } catch (error) { problem(error.message); }
}

/* --- set up */

async function setUp() {
  setUpTheme();
  const drop = byId("drop");
  for (const name of ["dragenter", "dragover"]) document.addEventListener(name, (event) => { event.preventDefault(); drop.classList.add("over"); });
  document.addEventListener("dragleave", (event) => { if (!event.relatedTarget) drop.classList.remove("over"); });
  document.addEventListener("drop", (event) => { event.preventDefault(); drop.classList.remove("over"); take([...event.dataTransfer.files]); });
  byId("file").addEventListener("change", (event) => { const files = [...event.target.files]; event.target.value = ""; take(files); });
  byId("toml").addEventListener("change", async (event) => {
    const [file] = event.target.files;
    if (!file) return;
    toml = { name: file.name, text: await file.text() };
    setText(byId("toml-name"), file.name);
  });
  document.querySelectorAll("input[name=kind]").forEach((one) => one.addEventListener("change", showKind));
  byId("builtin").addEventListener("change", draw);
  byId("add").addEventListener("click", () => addRotor(0.25, 0));
  byId("undo").addEventListener("click", () => { rotors.pop(); draw(); });
  byId("scale-name").addEventListener("change", (event) => setText(byId("scale-label"), { mass: "Mass, kg", k_T: "k_T, N s²", T_max: "T_max, N" }[event.target.value]));
  byId("form").addEventListener("submit", identify);
  byId("cancel").addEventListener("click", () => { if (running) running.abort(); });
  byId("compare").addEventListener("submit", compareResults);
  try {
    const { role } = await ask("/role");
    if (role !== "pilot") toggle(byId("drop-section"), false);
    builtins = await ask("/airframes");
    fill(byId("builtin"), make("option", { value: "" }, "choose a layout"), ...builtins.map((one) => make("option", { value: one.name }, one.name)));
    await listItems();
  } catch (error) { problem(error.message); }
}

setUp();
