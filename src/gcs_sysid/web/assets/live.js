"use strict";
/* Follows a session; a pilot can act. All numbers and words come from the server. */

let chosen = ""; // the parameter in the plot
let offered = []; // what may be done
let newest = null; // the snapshot shown
let plotting = 0; // the timer of the next plot
let drawn = null; // the plot
let said = {}; // what was spoken last, by kind
let counted = 0; // when the verdict was
let toastTimer = 0;

function toast(text) {
  setText(byId("toast"), text);
  clearTimeout(toastTimer);
  toastTimer = setTimeout(() => setText(byId("toast"), ""), 6000);
}

/* --- speech: a pilot's eyes are on the vehicle */

const speaking = () => byId("speak").getAttribute("aria-pressed") === "true";

function speak(key, text) {
  if ((said[key] ?? "") === text) return;
  said[key] = text;
  if (!text || !speaking() || !("speechSynthesis" in window)) return;
  if (key === "verdict" && (speechSynthesis.speaking || Date.now() - counted < 15000)) { said[key] = ""; return; } // later
  if (key === "verdict") counted = Date.now();
  if (key === "coach" || key === "link") speechSynthesis.cancel(); // an order that holds no more
  const words = new SpeechSynthesisUtterance(text);
  words.lang = "en";
  speechSynthesis.speak(words);
}

/* --- drawing */

function show(session) {
  newest = session;
  const { link, verdict, playback } = session;
  setText(byId("vehicle"), link.vehicle || "gcs-sysid");
  const state = byId("state");
  state.className = `chip ${link.state}`;
  setText(state, `${link.sign} ${link.state}`);
  setText(byId("clock"), `${session.t}${link.state === "ended" ? "" : session.flying ? ", flying" : ", on the ground"}, ${session.used} used${link.recording ? `, recording ${link.recording}` : ""}`);
  setText(byId("notice"), link.notice);
  toggle(byId("notice"), Boolean(link.notice));
  byId("headline").className = verdict.level;
  setText(byId("headline"), `${verdict.sign} ${verdict.headline}`);
  setText(byId("count"), `${verdict.reached}/${verdict.total}`);
  setText(byId("within"), `${verdict.reached} of ${verdict.total} parameters within the target of ±${session.target}`);
  listOf(byId("reasons"), verdict.reasons, (reason) => make("li", {}, reason));
  toggle(byId("baseline"), Boolean(session.baseline));
  if (session.baseline) setText(byId("baseline"), `${session.baseline.sign} against ${session.baseline.name}: ${session.baseline.text}`);
  showCoach(session.coach);
  showParameters(session.parameters);
  showHealth(session);
  listOf(byId("events"), session.events.toReversed(), (event) => make("li", {}, make("time", {}, event.t), event.text));
  toggle(byId("transport"), Boolean(playback));
  if (playback) showPlayback(playback);
  showVehicles(link.vehicles);
  for (const [kind, text] of Object.entries(session.call_outs)) speak(kind, text);
  if (!plotting) plot();
}

/* Children anew only where they differ: focus and scrolling stay, and a phone's battery. */
function listOf(parent, entries, child) {
  const key = JSON.stringify(entries);
  if (parent.dataset.key === key) return;
  parent.dataset.key = key;
  fill(parent, ...entries.flatMap(child));
}

function showCoach(coach) {
  toggle(byId("coach"), Boolean(coach));
  if (!coach) return;
  byId("coach").classList.toggle("enough", coach.enough);
  setText(byId("lead"), coach.enough ? "✓ ENOUGH" : coach.fly ? "▶ FLY" : "");
  setText(byId("advice"), coach.text);
  setText(byId("what-for"), coach.aim);
  toggle(byId("flown"), coach.fly && !coach.enough);
  byId("flown-bar").value = coach.progress;
  setText(byId("gains"), [coach.left, ...coach.gains].filter(Boolean).join(" · "));
  toggle(byId("what-for"), Boolean(coach.aim));
}

function showParameters(parameters) {
  const body = byId("parameters");
  if (!parameters.some((row) => row.name === chosen)) chosen = (parameters.find((row) => row.name === "Ixx") || parameters[0] || { name: "" }).name;
  const errors = parameters.some((row) => row.error);
  toggle(byId("error-head"), errors);
  const names = parameters.map((row) => row.name).join() + errors;
  if (body.dataset.names !== names) {
    body.dataset.names = names;
    fill(body, ...parameters.map((row) => make("tr", { id: `row-${row.name}` })));
  }
  for (const row of parameters) {
    const line = byId(`row-${row.name}`);
    const key = JSON.stringify([row, chosen === row.name]);
    if (line.dataset.key === key) continue;
    line.dataset.key = key;
    let head = line.firstElementChild; // the button keeps its focus
    if (!head) {
      head = make("th", { scope: "row", class: "choose" }, make("button", { type: "button", title: row.meaning, onclick: () => choose(row.name) }, row.name));
      line.append(head);
    }
    head.firstElementChild.setAttribute("aria-pressed", String(chosen === row.name));
    line.className = chosen === row.name ? "chosen" : "";
    while (head.nextSibling) head.nextSibling.remove();
    const bar = make("td", { class: "narrow-off" });
    if (row.done !== null) {
      const full = make("i");
      full.style.width = `${100 * row.done}%`;
      bar.append(make("span", { class: "bar", role: "img", "aria-label": `${Math.round(100 * row.done)} % of the way` }, full), " ");
    }
    bar.append(row.percent ? `±\u00a0${row.percent}` : "");
    line.append(valueCell(row), statusCell(row), bar);
    if (errors) line.append(make("td", { class: "number narrow-off" }, row.error));
  }
}

function choose(name) {
  chosen = name;
  document.querySelectorAll("#parameters tr").forEach((line) => {
    const is = line.id === `row-${name}`;
    line.className = is ? "chosen" : "";
    line.querySelector("button").setAttribute("aria-pressed", String(is));
    delete line.dataset.key;
  });
  plot();
}

function showHealth(session) {
  const { link, rotors } = session;
  const facts = [["Losses", link.lost], ["Gaps", String(link.gaps)],
    ...link.rates.map((rate) => [rate.name, `${rate.slow ? "✗ " : ""}${rate.rate} Hz${rate.slow ? ` of ${rate.asked}` : ""}`])];
  if (session.attitude) facts.push(["Roll, pitch, yaw", session.attitude.map((angle) => `${Math.round(angle)}°`).join(", ")]);
  listOf(byId("link"), facts, ([name, value]) => [make("dt", {}, name), make("dd", {}, value)]);
  toggle(byId("rotors-title"), rotors.length > 0);
  listOf(byId("rotors"), rotors.map((rotor, i) => ({ ...rotor, n: i + 1 })), (rotor) => {
    const full = make("i");
    full.style.width = `${50 * rotor.share}%`;
    return make("li", {}, `${rotor.n} ${rotor.spin} `, make("span", { class: "bar", "aria-hidden": "true" }, full), ` ${rotor.value}`);
  });
}

function showPlayback(playback) {
  setText(byId("playing"), `${playback.state}, ${playback.clock}`);
  setText(byId("pause"), playback.paused ? "Play" : "Pause");
  const seek = byId("seek");
  seek.max = playback.duration;
  if (document.activeElement !== seek) seek.value = playback.position;
}

function showVehicles(vehicles) {
  toggle(byId("vehicle-form"), offered.includes("vehicle") && vehicles.length > 1);
  listOf(byId("vehicles"), vehicles, (one) => make("option", { value: JSON.stringify(one.address), selected: one.chosen }, one.name));
}

/* --- the plot */

/* Now, and again a second later for what has come meanwhile; not while nothing comes. */
async function plot() {
  clearTimeout(plotting);
  const of = newest;
  plotting = setTimeout(() => { plotting = 0; if (newest !== of) plot(); }, 1000);
  if (!newest || !chosen || document.hidden) return;
  let history;
  try { history = await ask(`/live/history?name=${encodeURIComponent(chosen)}`); } catch { return; }
  if (history.name !== chosen) return;
  setText(byId("plot-text"), history.text);
  const figure = charts.unpack(history)[`history-${chosen}`];
  toggle(byId("plotted"), Boolean(figure));
  if (!figure) return;
  if (drawn) drawn.update(figure);
  else [drawn] = charts.show([[byId("plot"), figure]]);
}

/* --- acting */

async function act(action, values = {}) {
  try {
    const { said: text } = await ask("/live/action", post("", { action, ...values }));
    if (text) toast(text);
  } catch (error) { toast(error.message); }
}

function sure() {
  return new Promise((resolve) => {
    const dialog = byId("sure");
    const end = (answer) => { dialog.close(); resolve(answer); };
    byId("yes").onclick = () => end(true);
    byId("no").onclick = () => end(false);
    dialog.oncancel = () => resolve(false);
    dialog.showModal();
    byId("no").focus();
  });
}

async function press(event) {
  const { act: action, ...rest } = event.currentTarget.dataset;
  if (action === "reset" && !await sure()) return;
  const values = Object.fromEntries(Object.entries(rest).map(([key, value]) => [key, Number(value)]));
  if (action === "mark") values.text = "mark from the page";
  if (action === "report") toast("Writing a report ...");
  await act(action, values);
}

/* --- set up */

function setUpControls(scene) {
  offered = scene.actions;
  for (const button of document.querySelectorAll("[data-act]")) {
    toggle(button, offered.includes(button.dataset.act));
    button.addEventListener("click", press);
  }
  const acting = ["mark", "record", "report", "reset", "scale", "export"].some((name) => offered.includes(name));
  toggle(byId("controls"), acting);
  toggle(byId("scale-form"), offered.includes("scale"));
  toggle(byId("export-form"), offered.includes("export") && scene.exports.length > 0);
  fill(byId("target"), ...scene.exports.map((name) => make("option", { value: name }, name)));
  toggle(byId("seek"), offered.includes("seek"));
  byId("seek").addEventListener("change", (event) => act("seek", { position: Number(event.target.value) }));
  const submits = {
    "scale-form": () => act("scale", { name: byId("scale-name").value, value: Number(byId("scale").value.replace(",", ".")) }),
    "export-form": () => act("export", { target: byId("target").value }),
    "vehicle-form": () => act("vehicle", { address: JSON.parse(byId("vehicles").value) }),
  };
  for (const [name, submit] of Object.entries(submits)) byId(name).addEventListener("submit", (event) => { event.preventDefault(); submit(); });
  toggle(byId("role"), scene.role !== "pilot");
}

function showChecked(health) {
  setText(byId("health-text"), [health.text, ...(health.advice || [])].join(" "));
  toggle(byId("health-picture"), Boolean(health.look));
  if (health.look) byId("health-picture").src = `/live/health.svg?${health.look}`;
}

function follow() {
  const stream = new EventSource("/live");
  const gone = (text) => { setText(byId("notice"), text); toggle(byId("notice"), true); };
  stream.onmessage = (event) => {
    const { session, health, ended } = JSON.parse(event.data);
    if (session) show(session);
    if (health) showChecked(health);
    if (ended) { stream.close(); newest = null; clearTimeout(plotting); gone("The session has ended, and its page with it."); speak("link", "The session has ended."); }
  };
  stream.onerror = () => {
    gone(stream.readyState === EventSource.CLOSED ? "The page was refused: too many viewers, or the session has ended." : "No connection to gcs-sysid; retrying.");
  };
}

async function setUp() {
  setUpTheme();
  byId("speak").addEventListener("click", (event) => {
    event.currentTarget.setAttribute("aria-pressed", String(!speaking()));
    if (!("speechSynthesis" in window)) return toast("This browser has no speech synthesis.");
    if (!speaking()) return speechSynthesis.cancel();
    said = {};
    speak("on", "Call-outs on.");
  });
  try { setUpControls(await ask("/live/scene")); } catch (error) { toast(error.message); }
  follow();
}

setUp();
