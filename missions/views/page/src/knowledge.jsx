// Actions, functions with their designs, components with their configurations: how each stands at the instant shown, and why.
import { useEffect, useRef } from "preact/hooks";
import { useSignal } from "@preact/signals";
import { at, chosen, elements, run, selected, time, useAt } from "./state.js";
import { plainly, pretty, seconds } from "./format.js";
import { Mark, Name, Panel, reveal, Standing } from "./parts.jsx";

const GROUPS = { action: "Actions", function: "Functions", component: "Components" };

/** A design or configuration beside what it is for. */
function Part({ of }) {
  const isSelected = useAt("selected", of);
  return (
    <span class={`part ${isSelected ? "is-selected" : ""}`}>
      <Standing of={of} quiet />
      <Name of={of} />
      {isSelected ? <span class="tag">selected</span> : null}
    </span>
  );
}

function Item({ of, element }) {
  const isOpen = selected.value === of || [...(element.designs ?? []), ...(element.configurations ?? [])].map(String).includes(selected.value);
  const isRequired = useAt("required", of);
  const isActive = useAt("active", of);
  const parts = element.designs ?? element.configurations ?? [];
  return (
    <li class={`item ${isOpen ? "open" : ""}`}>
      <span class="head">
        <Standing of={of} />
        <Name of={of} />
        {isRequired ? <span class="tag">required</span> : null}
        {isActive ? <span class="tag runs">▶ runs</span> : null}
      </span>
      {parts.length > 0 && <span class="parts">{parts.map((part) => <Part key={part} of={part} />)}</span>}
      {isOpen && <Details of={of} />}
      {isOpen && selected.value !== of && <Details of={selected.value} />}
    </li>
  );
}

const Fact = ({ title, children }) => (
  <>
    <dt>{title}</dt>
    <dd>{children}</dd>
  </>
);

function Details({ of }) {
  const element = run.value.element(of);
  const [status, why, help, choice, parameters] = ["status", "why", "help", "choice", "parameters"].map((track) => at(track, of));
  const since = run.value.of("status", of).since(time.value);
  const inForce = Object.entries(parameters ?? element.parameters ?? {});
  return (
    <dl class="details" aria-label={`${element.kind} ${element.name}`}>
      <Fact title={element.name}>
        {element.kind}, <Mark status={status ?? ""} /> {since !== undefined && <small>since {seconds(since)}</small>}
      </Fact>
      {why && <Fact title="why">{pretty(why)}</Fact>}
      {help?.length > 0 && <Fact title="what would help"><ul>{help.map((one) => <li key={one}>{pretty(one)}</li>)}</ul></Fact>}
      {element.functions?.length > 0 && <Fact title="needs">{element.functions.map((one) => <Part key={one} of={one} />)}</Fact>}
      {element.components?.length > 0 && <Fact title="uses">{element.components.map((one) => <Part key={one} of={one} />)}</Fact>}
      {element.constraints?.length > 0 && (
        <Fact title="as long as">
          {element.constraints.map((one) => <span class="part" key={one}><Standing of={one} quiet /> <span class="name">{pretty(run.value.name(one))}</span></span>)}
        </Fact>
      )}
      {inForce.length > 0 && <Fact title={parameters ? "parameters in force" : "parameters"}><code>{inForce.map(([name, value]) => `${name} = ${plainly(value)}`).join(", ")}</code></Fact>}
      {choice && <Fact title="choice">{choice.chosen === null ? "nothing: " : `${run.value.name(choice.chosen)}: `}{pretty(choice.reason)}</Fact>}
      {choice?.alternatives.map((one) => (
        <Fact key={one.element} title={`not ${run.value.name(one.element)}`}>
          <Mark status={one.status} /> {one.priority !== null && <small>priority {one.priority}</small>} {pretty(one.reason)}
        </Fact>
      ))}
    </dl>
  );
}

export function Knowledge() {
  const body = useRef(null);
  const words = useSignal("");
  useEffect(() => reveal(body.current, body.current.querySelector(".badge")), [chosen.value]);
  const fits = ({ name }) => name.toLowerCase().includes(words.value.toLowerCase());
  const search = <input type="search" aria-label="search what is known" placeholder="search" value={words.value} onInput={({ target }) => (words.value = target.value)} />;
  return (
    <Panel id="knowledge" title="What is known" aside={search}>
      <div class="body" ref={body} tabIndex={-1}>
        {Object.entries(GROUPS).map(([kind, title]) => {
          const all = elements.value.filter(([, one]) => one.kind === kind && fits(one));
          return all.length > 0 && (
            <div key={kind}>
              <h3>{title}</h3>
              <ul>{all.map(([key, one]) => <Item key={key} of={key} element={one} />)}</ul>
            </div>
          );
        })}
      </div>
    </Panel>
  );
}
