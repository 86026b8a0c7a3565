// Light or dark: at first as the system has it. Canvases ask here for their colours.
import { effect, signal } from "@preact/signals";

export const theme = signal(matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");

export const toggleTheme = () => (theme.value = theme.value === "dark" ? "light" : "dark");

const colours = new Map();

effect(() => {
  document.documentElement.dataset.theme = theme.value;
  colours.clear();
});

/** The colour of a custom property as a canvas takes it. */
export function colour(name) {
  if (!colours.has(name)) {
    const probe = document.body.appendChild(document.createElement("i"));
    probe.style.color = `var(${name})`;
    colours.set(name, getComputedStyle(probe).color);
    probe.remove();
  }
  return colours.get(name);
}

