// The keyboard: what each key does, wherever the focus is, but where one types or where a list has keys of its own.
import { chosen, end, enlarge, enlarged, leap, seek, selected, start, step, time, zoomed } from "./state.js";
import { togglePlay } from "./player.js";
import { toggleTheme } from "./theme.js";

/** The panel that has the focus, else the tree. */
function panelInFocus() {
  const id = document.activeElement.closest(".panel")?.id ?? "tree";
  return ["whatif", "log", "disturb"].includes(id) ? "side" : id;
}

/** Each key as [its name, what it does, and how]. */
export const KEYS = {
  " ": ["Space", "play or pause", togglePlay],
  ArrowRight: ["→", "next change", () => step(1)],
  ArrowLeft: ["←", "previous change", () => step(-1)],
  PageDown: ["Page ↓", "10 s later", () => seek(time.value + 10)],
  PageUp: ["Page ↑", "10 s earlier", () => seek(time.value - 10)],
  Home: ["Home", "start", () => seek(start.value)],
  End: ["End", "end", () => seek(end.value)],
  n: ["n", "next adaptation", () => leap(1)],
  p: ["p", "previous adaptation", () => leap(-1)],
  "/": ["/", "search the tree", () => document.querySelector("#tree input[type=search]").focus()],
  e: ["e", "enlarge the panel in focus, or put it back", () => enlarge(enlarged.value ?? panelInFocus())],
  z: ["z", "all of the time again", () => (zoomed.value = null)],
  Escape: ["Esc", "nothing chosen, nothing enlarged", () => (chosen.value = selected.value = enlarged.value = null)],
  d: ["d", "light or dark", toggleTheme],
  "?": ["?", "these keys", () => document.querySelector("#keys").showModal()],
};

export function listenToKeys() {
  addEventListener("keydown", (event) => {
    const { target, key } = event;
    const doing = KEYS[key]?.[2];
    const isAsked = document.querySelector("dialog[open]"); // it has keys of its own, Esc closes it
    const isTyping = target.matches("input:not([type=range]), select, textarea") && key !== "Escape";
    const isOwn = event.defaultPrevented || event.ctrlKey || event.metaKey || event.altKey;
    const isPressing = key === " " && target.matches("button, summary, [role=treeitem]");
    const isSetting = target.matches("input[type=range]:not(#instant)") && key.length > 1;
    if (!doing || isAsked || isTyping || isOwn || isPressing || isSetting) return;
    event.preventDefault();
    doing();
  });
}
