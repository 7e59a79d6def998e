"use strict";

// The participant's identifier stands in the address after "#": the address resumes the study, whatever a mail added.

const byId = (id) => document.getElementById(id);
const SECTIONS = ["welcome", "question", "thanks"];
const LONGEST_MS = 86_400_000; // a page may be left open for days
const LONGEST_DOUBLE_MS = 500; // systems count two clicks within so long as a double one

const inAddress = () => (location.hash.match(/part_[0-9a-f]{32}/) ?? [""])[0];

let participant = inAddress();
let total = 0;
let position = null;
let shownAt = 0;
let running = null;

// The study itself says so; a 404 of something between it and the page is trouble that passes.
class Nobody extends Error {}

async function call(path, options) {
  const answer = await fetch(path, options);
  if (answer.status === 404 && (await answer.json().catch(() => ({}))).code === "not_found") throw new Nobody();
  if (!answer.ok) throw new Error(`The server answered ${answer.status}.`);
  return answer.status === 204 ? null : answer.json();
}

function send(method, body) {
  return { method, headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) };
}

function show(section) {
  for (const id of SECTIONS) byId(id).hidden = id !== section;
}

function describe(error) {
  if (error instanceof Nobody) return "This address belongs to no participant of this study. You may begin here anew.";
  return `${error.message} Nothing you answered before is lost; try again.`;
}

function trouble(error) {
  const line = byId("trouble");
  line.hidden = error === null;
  line.textContent = error === null ? "" : describe(error);
  // Where a section is shown, what failed is tried again there.
  byId("again").hidden = error === null || SECTIONS.some((id) => !byId(id).hidden);
}

function forget() {
  participant = "";
  position = null;
  history.replaceState(null, "", location.pathname + location.search);
  show("welcome");
}

// One thing at a time: a key held down or a double click must not answer the next question.
function alone(work) {
  if (running !== null) return;
  const finished = async () => {
    const who = participant;
    try {
      trouble(null);
      await work();
    } catch (error) {
      if (error instanceof Nobody && who === participant) forget();
      trouble(error);
    } finally {
      running = null;
    }
  };
  running = finished();
}

// Pictures that are ready to be shown: all of a question's are, before the first takes the place of another's.
async function loadPictures(paths, what) {
  const images = paths.map((path, k) => {
    const image = new Image();
    image.src = path;
    image.alt = `${what}, picture ${k + 1} of ${paths.length}`;
    image.draggable = false;
    return image;
  });
  await Promise.all(images.map((image) => image.decode()));
  return images;
}

async function ask(next) {
  const who = participant;
  const question = await call(`participants/${who}/questions/${next}`);
  const pictures = await Promise.all(
    ["reference", "left", "right"].map((which) => loadPictures(question[which], `${which} fabric`)),
  );
  if (who !== participant) return; // the address is another participant's by now
  ["reference", "left", "right"].forEach((which, k) => byId(which).replaceChildren(...pictures[k]));
  position = next;
  for (const side of ["left", "right"]) byId(side).setAttribute("aria-pressed", String(question.chosen === side));
  byId("back").disabled = position === 0;
  byId("bar").max = total;
  byId("bar").value = position;
  byId("count").textContent = `${position + 1} of ${total}`;
  show("question");
  document.activeElement?.blur();
  shownAt = performance.now();
}

async function goOn() {
  const state = await call(`participants/${participant}`);
  total = state.questions;
  if (state.next === null) {
    position = null;
    show("thanks");
  } else {
    await ask(state.next);
  }
}

async function choose(side) {
  if (position === null || byId("question").hidden) return;
  const milliseconds = Math.min(Math.round(performance.now() - shownAt), LONGEST_MS);
  await call(`participants/${participant}/answers/${position}`, send("PUT", { chosen: side, milliseconds }));
  await goOn();
}

async function back() {
  if (position !== null && position > 0) await ask(position - 1);
}

// Who has begun and not got to the first question goes on; nobody begins twice.
async function begin() {
  if (!participant) {
    const started = await call("participants", send("POST", { experience: byId("experience").value }));
    participant = started.participant;
    history.replaceState(null, "", `#${participant}`);
  }
  await goOn();
}

async function open() {
  const study = await call("study");
  document.title = study.name;
  byId("study-name").textContent = study.name;
  byId("question-count").textContent = study.questions;
  if (participant) await goOn();
  else if (location.hash.length > 1) throw new Nobody();
  else show("welcome");
}

byId("begin").addEventListener("submit", (event) => {
  event.preventDefault();
  alone(begin);
});
// The second click of a double one belongs to the question before, however soon the next one is there.
const isDouble = (event) => event.detail > 1 && performance.now() - shownAt < LONGEST_DOUBLE_MS;
for (const side of ["left", "right"]) {
  byId(side).addEventListener("click", (event) => {
    if (!isDouble(event)) alone(() => choose(side));
  });
}
byId("back").addEventListener("click", () => alone(back));
byId("again").addEventListener("click", () => alone(open));
byId("review").addEventListener("click", () => alone(() => ask(total - 1)));
document.addEventListener("keydown", (event) => {
  if (event.repeat || event.ctrlKey || event.altKey || event.metaKey || byId("question").hidden) return;
  const work = { ArrowLeft: () => choose("left"), ArrowRight: () => choose("right"), Backspace: back }[event.key];
  if (work === undefined) return;
  event.preventDefault();
  alone(work);
});
// Another participant's address: nothing of this one's question may be left, whatever is under way.
window.addEventListener("hashchange", async () => {
  participant = inAddress();
  position = null;
  show(null);
  await running;
  alone(open);
});
alone(open);
