// Light or dark: as the system has it, until the reader says otherwise. Canvases ask here for their colours.
import { computed, effect, signal } from "@preact/signals";

const dark = matchMedia("(prefers-color-scheme: dark)");
const system = signal(dark.matches ? "dark" : "light");
const wanted = signal(null);
dark.addEventListener("change", () => (system.value = dark.matches ? "dark" : "light"));

export const theme = computed(() => wanted.value ?? system.value);

export const toggleTheme = () => (wanted.value = theme.value === "dark" ? "light" : "dark");

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

