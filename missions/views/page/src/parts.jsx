// The small parts that every view is made of: panels, marks of status, references to elements, sizes.
import { useSignal } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import { may } from "./live.js";
import { chain, enlarge, enlarged, order, run, select, selected, stepsOf, swap, tab, useAt } from "./state.js";

/** Each status as [shape, tone]; the shapes differ, so that nobody needs the colours. */
const MARKS = {
  R: ["▶", "active", "running"], S: ["✓", "good", "success"], F: ["✕", "bad", "failure"], "": ["·", "idle", "not run"],
  feasible: ["○", "good"], solved: ["✓", "good"], satisfied: ["✓", "good"], completed: ["✓", "good"],
  unfeasible: ["✕", "bad"], failure: ["✕", "bad"], violated: ["✕", "bad"], failed: ["✕", "bad"],
  unsolved: ["!", "warn"], "configuration error": ["!", "warn"], "implicit configuration error": ["!", "warn"],
};

/** The mark of a status as [shape, tone, words]. */
export function markOf(status = "") {
  const [shape, tone, words = status || "unknown"] = MARKS[status] ?? MARKS[status.toUpperCase()] ?? ["?", "idle"];
  return [shape, tone, words];
}

export function Mark({ status, quiet }) {
  const [shape, tone, words] = markOf(status);
  return <span class={`mark ${tone}`} title={words}><i aria-hidden="true">{shape}</i><span class={quiet && "unseen"}>{words}</span></span>;
}

/** The status of an element at the instant shown. */
export const Standing = ({ of, quiet }) => <Mark status={useAt("status", of) ?? ""} quiet={quiet} />;

/** The panels that share a place, with their titles. */
const SHARED = { whatif: "What if", log: "Events", disturb: "Disturb" };

const Tabs = () => (
  <div class="tools tabs" role="group" aria-label="shown here">
    {Object.entries(SHARED).filter(([id]) => id !== "disturb" || may.value.includes("inject")).map(([id, title]) => (
      <button key={id} aria-pressed={tab.value === id} onClick={() => (tab.value = id)}>{title}</button>
    ))}
  </div>
);

export function Panel({ id, title, aside, children }) {
  const shared = id in SHARED;
  const of = shared ? "side" : id;
  const isLarge = enlarged.value === of;
  const turn = order.value.indexOf(of);
  return (
    <section class={`panel ${isLarge ? "is-large" : ""}`} id={id} aria-labelledby={`${id}-title`}
      style={{ order: turn, "--slot": `slot${turn}` }}>
      <header>
        <h2 id={`${id}-title`} class={shared && "unseen"}>{title}</h2>
        {shared && <Tabs />}
        <div class="tools">
          {aside}
          <button class="icon" aria-label={`${title}: ${isLarge ? "back to its place" : "fill the page"}`} aria-pressed={isLarge}
            title="fill the page, or back (e)" onClick={() => enlarge(of)}>⤢</button>
          {!isLarge && (
            <button class="icon" aria-label={`${title}: change places with the next panel`} title="change places with the next panel"
              onClick={() => swap(of)}>⇄</button>
          )}
        </div>
      </header>
      {children}
    </section>
  );
}

/** The numbers of the steps of the chosen chain that are about some elements. */
export const Badges = ({ of }) =>
  stepsOf(of).map((step) => <span class="badge" key={step}><span class="unseen">step </span>{step}</span>);

/** The steps of the chosen chain put together by where they are drawn, as [place, first step, "3–6"]; no place, no mark. */
export function stepsBy(placeOf) {
  const found = new Map();
  chain.value.forEach((step, index) => {
    const place = placeOf(step);
    if (place !== null) found.set(place, [...(found.get(place) ?? []), [step, index + 1]]);
  });
  return [...found].map(([place, steps]) => [place, steps[0][0], [...new Set([steps[0][1], steps.at(-1)[1]])].join("–")]);
}

/** A field to search in. */
export const Search = ({ of, words }) => (
  <input type="search" aria-label={`search ${of}`} placeholder="search" value={words.value}
    onInput={({ target }) => (words.value = target.value)} />
);

/** The name of an element; pressing it chooses the element wherever it is shown. */
export const Name = ({ of }) => (
  <button class="plain name" aria-pressed={selected.value === of} onClick={() => select(of)}>
    {run.value.name(of)}<Badges of={[of]} />
  </button>
);

/** A ref for an element, and its size [CSS px] as a signal. */
export function useSize() {
  const ref = useRef(null);
  const size = useSignal([0, 0]);
  useEffect(() => {
    const watch = new ResizeObserver(([{ contentRect }]) => (size.value = [contentRect.width, contentRect.height]));
    watch.observe(ref.current);
    return () => watch.disconnect();
  }, []);
  return [ref, size];
}

/** Scroll a list, never the page, until something in it is in sight. */
export function reveal(list, item) {
  if (!list || !item || list.scrollHeight <= list.clientHeight) return;
  const [outer, inner] = [list.getBoundingClientRect(), item.getBoundingClientRect()];
  if (inner.top < outer.top || inner.bottom > outer.bottom) list.scrollTop += inner.top - outer.top - outer.height / 3;
}
