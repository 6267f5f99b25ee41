// People in 3D: joints of the newest instant, which the server locates while a page shows them.
"use strict";
// Instants from which the floor is laid, and the age from which joints are not live; a slow machine gives one in 2 s.
const FLOOR_INSTANTS = 60, OLD_PEOPLE_S = 4;
const people = {isShown: false, words: "", came: null, walk: null, scene: null, path: null, recent: []};

function askForPeople() {
  link.say("people", {is_shown: people.isShown && !document.hidden});
}

function showPeople({words, is_over: isOver, people: joints, bones, path}) {
  people.words = words;
  seen("again").hidden = !isOver;
  if (path?.subject) people.path = path;
  people.came = joints ? performance.now() : null;
  if (joints && people.path) {
    people.scene ||= {path: people.path, whole: true, instants: []};
    people.scene.bones = bones;
    people.walk ||= startWalk();
  }
  if (joints && people.scene && !people.walk) people.words = "This browser shows no 3D (WebGL 2).";
  // A hidden page draws nothing, so it acknowledges nothing and costs the link nothing.
  requestAnimationFrame(() => {
    if (joints && people.walk) drawPeople(joints);
    showPeopleWords();
    link.say("seen", {picture: "people"});
  });
}

// A phone takes the GPU from pages in the background; then another canvas shows the next people.
function startWalk() {
  const canvas = seen("walk");
  canvas.addEventListener("webglcontextlost", () => {
    people.walk = null;
    canvas.replaceWith(canvas.cloneNode());
  });
  return makeWalk(canvas, people.scene, makePainter, () => {});
}

function drawPeople(joints) {
  const instant = {people: []};
  for (const [number, own] of Object.entries(joints)) instant.people[number - 1] = own;
  if (instant.people.length) people.recent = [...people.recent.slice(1 - FLOOR_INSTANTS), instant];
  people.walk.painter.layFloor(people.recent);
  people.walk.showNow(instant);
}

function showPeopleWords() {
  const age = people.came === null ? 0 : (performance.now() - people.came) / 1000, isOld = age > OLD_PEOPLE_S;
  seen("people").classList.toggle("old", people.came === null || isOld);
  seen("people-words").textContent = (people.words && capital(people.words)) + (isOld ? `; ${ago(age)}` : "");
}
setInterval(showPeopleWords, 1000);

seen("in-3d").onclick = () => {
  people.isShown = !people.isShown;
  document.body.classList.toggle("in-3d", people.isShown);
  document.body.classList.remove("taken");
  seen("in-3d").setAttribute("aria-pressed", String(people.isShown));
  showPeople({words: "One moment …"});
  askForPeople();
};
seen("again").onclick = askForPeople;
seen("middle").onclick = () => {
  if (!people.walk) return;
  people.scene.path = people.path;
  people.walk.goToMiddle();
};
document.addEventListener("visibilitychange", askForPeople);
