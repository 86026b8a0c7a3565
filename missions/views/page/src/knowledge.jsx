// Actions, functions with their designs, components with their configurations: how each stands at the instant shown, and why.
import { useSignal } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import { clock, figure, pretty } from "./format.js";
import { Mark, Name, Panel, reveal, Search, Standing } from "./parts.jsx";
import { at, chosen, elements, run, selected, time, useAt } from "./state.js";

const GROUPS = { action: "Actions", function: "Functions", component: "Components" };

/** A design or configuration beside what it is for, or what another element needs. */
function Part({ of }) {
  const isSelected = useAt("selected", of);
  return (
    <span class={`part ${isSelected ? "is-selected" : ""}`}>
      <Standing of={of} quiet /><Name of={of} />
      {isSelected ? <span class="tag">selected</span> : null}
    </span>
  );
}

function Item({ of, element: { kind, requires } }) {
  const parts = kind === "action" ? [] : requires;
  const open = [of, ...parts].filter((one) => one === selected.value);
  const isRequired = useAt("required", of);
  const isActive = useAt("active", of);
  return (
    <li class={`item ${open.length ? "open" : ""}`}>
      <span class="top">
        <Standing of={of} /><Name of={of} />
        {isRequired ? <span class="tag">required</span> : null}
        {isActive ? <span class="tag runs">▶ runs</span> : null}
      </span>
      {parts.length > 0 && <span class="parts">{parts.map((part) => <Part key={part} of={part} />)}</span>}
      {open.map((one) => <Details key={one} of={one} />)}
    </li>
  );
}

const Fact = ({ title, children }) => <><dt>{title}</dt><dd>{children}</dd></>;
const Condition = ({ of }) => <span class="part"><Standing of={of} quiet /> <span class="name">{pretty(run.value.name(of))}</span></span>;

/** Why a design or configuration is chosen, and why each other one is not. */
const Choice = ({ chosen: part, reason, alternatives }) => (
  <>
    <Fact title="choice"><span class="name">{part === null ? "nothing" : run.value.name(part)}</span>: {pretty(reason)}</Fact>
    {alternatives.map((one) => (
      <Fact key={one.element} title={`not ${run.value.name(one.element)}`}>
        <Mark status={one.status} /> {one.priority !== null && <small>priority {one.priority}</small>} {pretty(one.reason)}
      </Fact>
    ))}
  </>
);

function Details({ of }) {
  const { kind, name, constraints, requires, ...element } = run.value.element(of);
  const [why, help, choice, inForce] = ["why", "help", "choice", "parameters"].map((track) => at(track, of));
  const since = run.value.of("status", of).since(time.value);
  const parameters = Object.entries(inForce ?? element.parameters ?? {});
  const needs = ["action", "function design"].includes(kind) ? requires : [];
  return (
    <dl class="details" aria-label={`${kind} ${name}`}>
      <Fact title={kind}><Standing of={of} /> {since !== undefined && <small>since {clock(since)}</small>}</Fact>
      {why && <Fact title="why">{pretty(why)}</Fact>}
      {help?.length > 0 && <Fact title="what would help"><ul>{help.map((one) => <li key={one}>{pretty(one)}</li>)}</ul></Fact>}
      {needs.length > 0 && <Fact title="needs">{needs.map((one) => <Part key={one} of={one} />)}</Fact>}
      {constraints.length > 0 && <Fact title="as long as">{constraints.map((one) => <Condition key={one} of={one} />)}</Fact>}
      {parameters.length > 0 && (
        <Fact title={inForce ? "parameters in force" : "parameters"}>
          <code>{parameters.map(([key, value]) => `${key} = ${typeof value === "number" ? figure(value) : value}`).join(", ")}</code>
        </Fact>
      )}
      {choice && <Choice {...choice} />}
    </dl>
  );
}

export function Knowledge() {
  const body = useRef(null);
  const words = useSignal("");
  useEffect(() => reveal(body.current, body.current.querySelector(".details, .badge")), [chosen.value, selected.value]);
  const isFound = ([, { name }]) => name.toLowerCase().includes(words.value.toLowerCase());
  const group = ([kind, title]) => {
    const found = elements.value.filter(([, one]) => one.kind === kind).filter(isFound);
    return found.length > 0 && (
      <div key={kind}>
        <h3>{title}</h3>
        <ul>{found.map(([key, one]) => <Item key={key} of={key} element={one} />)}</ul>
      </div>
    );
  };
  return (
    <Panel id="knowledge" title="What is known" aside={<Search of="what is known" words={words} />}>
      <div class="body" ref={body} tabIndex={0} role="group" aria-label="actions, functions and components">
        {Object.entries(GROUPS).map(group)}
      </div>
    </Panel>
  );
}
