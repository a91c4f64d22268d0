// Keys, where nobody writes into a field: what they do is said by H.
const step_time = (by) => {
  animator.pause();
  const to = Math.min(Math.max(+slider.value + by, 0), animator.duration);
  animator.seek(to);
  animator.display_progress(to);
  viewer.set_dirty();
};
const SIGNS = { " ": "Space", arrowup: "\u2191", arrowdown: "\u2193", arrowleft: "\u2190", arrowright: "\u2192" };
const plays = () => byId("es-play").style.display === "flex";
const show_keys = () => {
  const box = byId("es-toast"), lines = ACTIONS.filter(([, , may]) => may()).map(([k, what]) =>
    `${SIGNS[k] || k[0].toUpperCase() + k.slice(1)}  ${what}`).join("\n");
  if (box.style.display === "block" && box.dataset.keys) box.style.display = "none";
  else {
    toast(lines);
    box.dataset.keys = "yes";
  }
};
const ACTIONS = [  // key, what it does, when it does it, how
  ["h", "what the keys do", () => true, show_keys],
  ["f", "all in the picture", () => !!home, () => { look(...home); viewer.set_dirty(); }],
  ["c", "the card, more or less of it", () => !!newest, () => fold(!folded)],
  [" ", "play or pause", plays, () => byId("es-toggle").click()],
  ["arrowleft", "back by half a second", plays, () => step_time(-0.5)],
  ["arrowright", "on by half a second", plays, () => step_time(0.5)],
  ["1", "show or hide the first of the bar, and so on", () => Object.keys(buttons).length > 0, () => { }],
];
window.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || /^(INPUT|SELECT|TEXTAREA)$/.test(event.target.tagName)) return;
  const key = event.key.toLowerCase();
  if (key === " " && event.target.tagName === "BUTTON") return;  // which it presses
  if (/^[1-9]$/.test(key)) {
    const button = byId("es-bar").querySelectorAll("button[aria-pressed]")[+key - 1];
    if (button) button.click();
    return;
  }
  const action = ACTIONS.find(([k, , may]) => k === key && may());
  if (!action) return;
  event.preventDefault();
  action[3]();
});
