// The address keeps the instant and the choice: #t=151.0&a=7 (adaptation) &e=12 (element) &r=1 (the second run).
import { batch, effect } from "@preact/signals";
import { adaptations, chosen, isFollowing, run, runs, seek, selected, shown, time } from "./state.js";

const LATER_MS = 200; // browsers ration how often an address may change

/** Go where the address says; whether it names an instant. */
export function readLink() {
  const said = new URLSearchParams(location.hash.slice(1));
  const t = parseFloat(said.get("t"));
  if (said.size && run.value) {
    batch(() => {
      shown.value = runs.value[said.get("r")] ? Number(said.get("r")) : 0;
      chosen.value = adaptations.value.some(([key]) => key === said.get("a")) ? said.get("a") : null;
      selected.value = said.get("e");
      if (Number.isFinite(t)) seek(t);
    });
  }
  return Number.isFinite(t);
}

export function keepLink() {
  let timer;
  addEventListener("hashchange", readLink);
  effect(() => {
    if (!run.value || location.protocol === "about:") return; // nothing to link to yet, or ever: inside a notebook
    const said = new URLSearchParams();
    if (!isFollowing.value) said.set("t", String(Math.round(time.value * 1000) / 1000));
    if (chosen.value !== null) said.set("a", chosen.value);
    if (selected.value !== null) said.set("e", selected.value);
    if (shown.value) said.set("r", shown.value);
    clearTimeout(timer);
    timer = setTimeout(() => history.replaceState(null, "", `#${said}`), LATER_MS);
  });
}
