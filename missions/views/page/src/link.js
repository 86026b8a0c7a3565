// The address keeps what is shown: #t=151.0&a=7 (adaptation) &e=12 (element) &p=tree (enlarged)
// &o=scene,tree,... (order of the panels) &b=log (of those that share a place) &z=10,20 (the time that is zoomed).
import { batch, effect } from "@preact/signals";
import { adaptations, chosen, enlarged, isFollowing, order, PANELS, run, seek, selected, tab, time, zoomed } from "./state.js";

const LATER_MS = 200; // browsers ration how often an address may change

/** Go where the address says; whether it names an instant. */
export function readLink() {
  const said = new URLSearchParams(location.hash.slice(1));
  const t = parseFloat(said.get("t"));
  if (said.size && run.value) {
    batch(() => {
      chosen.value = adaptations.value.some(([key]) => key === said.get("a")) ? said.get("a") : null;
      selected.value = said.get("e");
      enlarged.value = PANELS.includes(said.get("p")) ? said.get("p") : null;
      tab.value = said.get("b") ?? tab.value;
      const panels = (said.get("o") ?? "").split(",");
      order.value = [...panels].sort().join() === [...PANELS].sort().join() ? panels : PANELS;
      const ends = (said.get("z") ?? "").split(",").map(parseFloat);
      zoomed.value = ends.length === 2 && ends[0] < ends[1] ? ends : null;
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
    if (enlarged.value) said.set("p", enlarged.value);
    if (tab.value !== "whatif") said.set("b", tab.value);
    if (order.value !== PANELS) said.set("o", order.value);
    if (zoomed.value) said.set("z", zoomed.value);
    clearTimeout(timer);
    timer = setTimeout(() => history.replaceState(null, "", `#${said}`), LATER_MS);
  });
}
