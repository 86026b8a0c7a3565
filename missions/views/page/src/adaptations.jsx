// Adaptations: what caused each, what was decided, what was changed, and how soon; and the chain of the one that is chosen.
import { useEffect, useRef } from "preact/hooks";
import { adaptation, adaptations, chain, choose, chosen, run, runs, seek, shown, time } from "./state.js";
import { pretty, seconds } from "./format.js";
import { Name, Panel, reveal } from "./parts.jsx";

const reaction = (one) => (one.reaction === null ? "never in force" : `in force after ${one.reaction.toFixed(2)} s`);

function Item({ id, one }) {
  const isChosen = chosen.value === id;
  return (
    <li class={one.t > time.value ? "later" : ""}>
      <button class={`adaptation plain ${one.kind}`} aria-pressed={isChosen} onClick={() => choose(id)}>
        <span class="when">
          <b>{seconds(one.t)}</b> <span class="kind">{one.kind}</span>
        </span>
        <span class="cause">{pretty(one.cause)}</span>
        <span class="changed">→ {pretty(one.changed)}</span>
        <small>{reaction(one)}</small>
      </button>
    </li>
  );
}

export function Adaptations({ differences }) {
  const list = useRef(null);
  useEffect(() => reveal(list.current, list.current.querySelector("[aria-pressed=true]")), [chosen.value]);
  const known = adaptations.value;
  return (
    <Panel id="adaptations" title="Adaptations" aside={<small>{known.length}</small>}>
      <div class="body" ref={list} tabIndex={-1}>
        {runs.value.length > 1 && <Differences all={differences} />}
        <ol>{known.map(([key, one]) => <Item key={key} id={key} one={one} />)}</ol>
        {known.length === 0 && <p class="muted">Nothing had to be adapted.</p>}
      </div>
    </Panel>
  );
}

function Differences({ all }) {
  const go = (one) => {
    const side = one.a === null ? "b" : "a";
    shown.value = side === "a" ? 0 : 1;
    if (one[side] !== null && chosen.value !== String(one[side])) choose(String(one[side]));
    seek(one.t);
  };
  return (
    <details open class="differences">
      <summary>What differs ({all.length})</summary>
      <ol>
        {all.map((one, index) => (
          <li key={index}>
            <button class="plain" onClick={() => go(one)}>
              <b>{seconds(one.t)}</b> {pretty(one.words)}
            </button>
          </li>
        ))}
      </ol>
    </details>
  );
}

/** The chain from the cause to what was in force, a step after the other; each leads to its instant. */
export function Chain() {
  if (!adaptation.value) return null;
  return (
    <section class="chain" aria-label={`adaptation at ${seconds(adaptation.value.t)}: from its cause to its effect`}>
      <p>
        <b>{seconds(adaptation.value.t)}</b> {pretty(adaptation.value.decided)}
      </p>
      <ol>
        {chain.value.map((one, index) => (
          <li key={index} class={one.t > time.value ? "later" : ""}>
            <button class="plain" onClick={() => seek(one.t)}>
              <span class="badge">{index + 1}</span> <small>{seconds(one.t)} · {one.what}</small>
              <span class="words">{pretty(one.words)}</span>
            </button>
            {one.elements.length > 0 && (
              <span class="about">{one.elements.map((element) => <Name key={element} of={element}>{run.value.name(element)}</Name>)}</span>
            )}
          </li>
        ))}
      </ol>
    </section>
  );
}
