// The tree at the instant shown, as an outline of which only the rows in sight are made, or drawn; and the node that is chosen.
import { useComputed, useSignal } from "@preact/signals";
import { useEffect } from "preact/hooks";
import { clock } from "./format.js";
import { firstOfChain, isOpen, nodes, pick, query, ROW, rows, selectedNode, stateOf, toggle, toggleAll } from "./forest.js";
import { Graph } from "./graph.jsx";
import { Badges, Mark, Name, Panel, Search, Standing, useSize } from "./parts.jsx";
import { at, chosen, run } from "./state.js";

const KINDS = { sequence: "→", selector: "?", parallel: "⇉", decorator: "◇", action: "■", condition: "○", plan: "≡" };
const MORE = 5; // rows that are made beyond those in sight
const isOld = (status) => /[rsf]/.test(status);

function Row({ node, index, of }) {
  const [status, feedback] = useComputed(() => stateOf(node.uid)).value;
  const { uid, depth, kind, type, name, children, elements } = node;
  const turn = (event) => {
    event.stopPropagation();
    toggle(node);
  };
  return (
    <div role="treeitem" id={`node-${uid}`} class={`row ${isOld(status) ? "stands" : ""}`} onClick={() => pick(node)}
      style={{ top: `${index * ROW}px`, paddingLeft: `${6 + depth * 14}px` }} aria-level={depth + 1} aria-posinset={index + 1}
      aria-setsize={of} aria-selected={selectedNode.value === uid} aria-expanded={children.length ? isOpen(node) : undefined}>
      <span class="turn" aria-hidden="true" onClick={turn}>{children.length > 0 && (isOpen(node) ? "▾" : "▸")}</span>
      <Mark status={status} quiet />
      <span class="kind" title={`${kind}: ${type}`} aria-label={kind} role="img">{KINDS[kind] ?? "•"}</span>
      <span class="label">{name}</span>
      <Badges of={elements} />
      {elements.slice(0, 1).map((element) => <Standing key={element} of={element} quiet />)}
      <span class="feedback">{feedback}</span>
    </div>
  );
}

/** Where each key of an outline leads from a node in a list of rows; null where it only opens or closes. */
const MOVES = {
  ArrowDown: (list, node) => list[list.indexOf(node) + 1],
  ArrowUp: (list, node) => list[list.indexOf(node) - 1],
  Home: (list) => list[0],
  End: (list) => list.at(-1),
  ArrowRight: (_, node) => node && (isOpen(node) ? node.children[0] : toggle(node, true)),
  ArrowLeft: (_, node) => node && (isOpen(node) && node.children.length ? toggle(node, false) : node.above),
};

function Outline() {
  const [list, size] = useSize();
  const top = useSignal(0);
  const all = rows.value;
  const bring = (node) => {
    const place = rows.value.indexOf(node) * ROW;
    const { scrollTop, clientHeight } = list.current;
    if (place < scrollTop || place + ROW > scrollTop + clientHeight) list.current.scrollTop = place - clientHeight / 3;
  };
  useEffect(() => {
    const node = chosen.value !== null && firstOfChain();
    if (node) bring(node);
  }, [chosen.value]);
  const onKeyDown = (event) => {
    if (!MOVES[event.key]) return;
    event.preventDefault();
    const next = MOVES[event.key](all, all.find(({ uid }) => uid === selectedNode.value));
    if (!next) return;
    pick(next);
    bring(next);
  };
  const first = Math.max(0, Math.floor(top.value / ROW) - MORE);
  const last = Math.ceil((top.value + size.value[1]) / ROW) + MORE;
  const active = all.slice(first, last).some(({ uid }) => uid === selectedNode.value) ? `node-${selectedNode.value}` : undefined;
  return (
    <div class="outline" role="tree" aria-label="nodes of the tree" tabIndex={0} aria-activedescendant={active} ref={list}
      onScroll={({ target }) => (top.value = target.scrollTop)} onKeyDown={onKeyDown}>
      <div role="none" style={{ height: `${all.length * ROW}px` }}>
        {all.slice(first, last).map((node, index) => <Row key={node.uid} node={node} index={first + index} of={all.length} />)}
      </div>
    </div>
  );
}

/** What there is to say of the node that is chosen. */
function Chosen() {
  const node = nodes.value.find(({ uid }) => uid === selectedNode.value);
  if (!node) return null;
  const [status, feedback] = stateOf(node.uid);
  return (
    <div class="chosen">
      <p>
        <Mark status={status} /> <b>{node.name}</b> <small>{node.type}{isOld(status) && ", since an earlier tick"}</small> {feedback}
      </p>
      {node.elements.map((one) => <p key={one}><Standing of={one} /> <Name of={one} /> {at("why", one)}</p>)}
    </div>
  );
}

/** The steps of the task plan that was made last, if anything planned, and which are under way. */
function Plan() {
  const plan = run.value.keys("taskplan").map((key) => at("taskplan", key)).findLast(Boolean);
  const doing = nodes.value.filter(({ kind }) => kind === "plan").map(({ uid }) => stateOf(uid)[1]).join();
  return plan && (
    <details class="chosen" open>
      <summary>Plan of {clock(plan.t)}: {plan.outcome} <small>{plan.reason}</small></summary>
      <ol>{plan.steps.map((step) => <li key={step} aria-current={doing.includes(step) && "step"}><code>{step}</code></li>)}</ol>
    </details>
  );
}

/** What the marks mean: statuses of nodes and elements, and kinds of nodes. */
const Legend = () => (
  <details class="key">
    <summary>Legend</summary>
    <ul>
      {["R", "S", "F", "", "feasible", "unfeasible", "unsolved"].map((status) => <li key={status}><Mark status={status} /></li>)}
      <li><small>faint: from an earlier tick</small></li>
      {Object.entries(KINDS).map(([kind, sign]) => <li key={kind}><span class="kind" aria-hidden="true">{sign}</span> {kind}</li>)}
    </ul>
  </details>
);

export function Tree() {
  const isDrawn = useSignal(false);
  const aside = (
    <div class="tools">
      <Search of="the tree" words={query} />
      <button onClick={() => toggleAll(true)} aria-label="open every node" title="open every node">▾</button>
      <button onClick={() => toggleAll(false)} aria-label="close every node" title="close every node">▸</button>
      <button aria-pressed={isDrawn.value} onClick={() => (isDrawn.value = !isDrawn.value)}>Drawn</button>
    </div>
  );
  const View = isDrawn.value ? Graph : Outline;
  return (
    <Panel id="tree" title={`Tree · ${nodes.value.length} node${nodes.value.length === 1 ? "" : "s"}`} aside={aside}>
      {nodes.value.length > 0 ? <View /> : <p class="body muted">No tree at this instant.</p>}
      <Plan />
      <Chosen />
      <Legend />
    </Panel>
  );
}
