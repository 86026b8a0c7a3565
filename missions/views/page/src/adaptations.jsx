// Adaptations: what caused each, what was decided, what was changed, and how soon; and the chain of the one that is chosen.
import { useEffect, useRef } from "preact/hooks";
import { clock, pretty } from "./format.js";
import { Panel, reveal } from "./parts.jsx";
import { adaptation, adaptations, chain, choose, chosen, seek, selected, time } from "./state.js";

const Item = ({ id, one }) => (
  <li class={one.t > time.value ? "later" : ""}>
    <button class={`adaptation plain ${one.kind}`} aria-pressed={chosen.value === id} onClick={() => choose(id)}>
      <span><b>{clock(one.t)}</b> <span class="kind">{one.kind}</span></span>
      <span>{pretty(one.cause)}</span>
      <span class="changed">{pretty(one.changed)}</span>
      <small>{one.reaction === null ? "never in force" : `in force after ${one.reaction.toFixed(2)} s`}</small>
    </button>
  </li>
);

export function Adaptations() {
  const list = useRef(null);
  useEffect(() => reveal(list.current, list.current.querySelector("[aria-pressed=true]")), [chosen.value]);
  const all = adaptations.value;
  return (
    <Panel id="adaptations" title="Adaptations" aside={<small>{all.length}</small>}>
      <div class="body" ref={list} tabIndex={0} role="group" aria-label="list of adaptations">
        <ol>{all.map(([key, one]) => <Item key={key} id={key} one={one} />)}</ol>
        {all.length === 0 && <p class="muted">Nothing had to be adapted.</p>}
      </div>
    </Panel>
  );
}

function Step({ number, t, what, words, elements }) {
  const go = () => {
    seek(t);
    if (elements.length) [selected.value] = elements;
  };
  return (
    <li class={t > time.value ? "later" : ""}>
      <button class="plain" onClick={go}>
        <span class="badge">{number}</span> <small>{clock(t)} · {what}</small>
        <span class="words">{pretty(words)}</span>
      </button>
    </li>
  );
}

/** The chain from the cause to what was in force, a step after the other; each leads to its instant and its element. */
export function Chain() {
  if (!adaptation.value) return null;
  const { t, decided } = adaptation.value;
  return (
    <section class="chain" aria-label={`adaptation at ${clock(t)}, from its cause to its effect`}>
      <button class="close" aria-label="let go of this adaptation" title="Esc" onClick={() => (chosen.value = null)}>✕</button>
      <p><b>{clock(t)}</b> {pretty(decided)}</p>
      <ol>{chain.value.map((one, index) => <Step key={index} number={index + 1} {...one} />)}</ol>
    </section>
  );
}
