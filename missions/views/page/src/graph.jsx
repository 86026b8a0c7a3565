// The tree drawn on a canvas: dragged, zoomed, and drawn anew at each instant; what is out of sight is left out.
import { useSignal, useSignalEffect } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import { BOX, drawing, nodes, pick, selectedNode, stateOf } from "./forest.js";
import { at, chosen, enlarged, stepsOf } from "./state.js";
import { markOf, useSize } from "./parts.jsx";
import { colour, theme } from "./theme.js";

const [READABLE, LEGIBLE] = [0.8, 0.45]; // of its size: what is drawn first; a box that is smaller has no words
const TONES = { good: "--good", bad: "--bad", active: "--accent", warn: "--warn", idle: "--edge" };
const brief = (text, most = 21) => (text.length > most ? `${text.slice(0, most - 1)}…` : text);

function drawLink(context, { x, y, from }) {
  if (!from) return;
  const [start, end] = [from.x + BOX.width, y + BOX.height / 2];
  context.beginPath();
  context.moveTo(start, from.y + BOX.height / 2);
  context.bezierCurveTo(start + 20, from.y + BOX.height / 2, x - 20, end, x, end);
  context.stroke();
}

function drawBox(context, { node, x, y }, isWorded) {
  const [status] = stateOf(node.uid);
  const [shape, tone] = markOf(status);
  const isOn = status === "R";
  context.fillStyle = colour(isOn ? "--accent-soft" : "--panel");
  context.strokeStyle = colour(TONES[tone]);
  context.globalAlpha = status === "" ? 0.75 : 1;
  context.beginPath();
  context.roundRect(x, y, BOX.width, BOX.height, 4);
  context.fill();
  context.stroke();
  if (selectedNode.value === node.uid) context.strokeRect(x - 3, y - 3, BOX.width + 6, BOX.height + 6);
  if (isWorded) {
    context.fillStyle = colour(TONES[tone]);
    context.fillText(shape, x + 7, y + 16);
    context.fillStyle = colour("--ink");
    context.fillText(brief(node.name), x + 24, y + 16);
    const element = node.elements[0];
    const [sign, feasibility] = element === undefined ? ["", "idle"] : markOf(at("status", element));
    context.fillStyle = colour(TONES[feasibility]);
    context.fillText(sign, x + BOX.width - 16, y + 16);
  }
  context.globalAlpha = 1;
  const steps = stepsOf(node.elements);
  if (!steps.length) return;
  context.fillStyle = colour("--chain");
  const wide = 9 * steps.length + 8;
  context.fillRect(x + BOX.width - wide, y - 10, wide, 13); // above the name, where no mark is
  context.fillStyle = colour("--panel");
  context.fillText(steps.join(" "), x + BOX.width - wide + 5, y + 1);
}

export function Graph() {
  const [frame, size] = useSize();
  const canvas = useRef(null);
  const view = useSignal({ scale: 1, x: 12, y: 12 });

  const fit = (least = 0) => {
    const [{ places, width, height }, [wide, high]] = [drawing.peek(), size.peek()];
    const scale = Math.max(least, Math.min(1, (wide - 24) / width, (high - 24) / height));
    view.value = { scale, x: 12, y: least === scale ? high / 2 - places[0].y * scale : Math.max(12, (high - height * scale) / 2) };
  };
  const zoom = (factor, [x, y] = [size.value[0] / 2, size.value[1] / 2]) => {
    const scale = Math.min(2.5, Math.max(0.03, view.value.scale * factor));
    const grown = scale / view.value.scale;
    view.value = { scale, x: x - (x - view.value.x) * grown, y: y - (y - view.value.y) * grown };
  };

  useSignalEffect(() => {
    const [[wide, high], { scale, x, y }, ratio] = [size.value, view.value, devicePixelRatio];
    theme.value;
    if (!wide || !canvas.current) return;
    Object.assign(canvas.current, { width: wide * ratio, height: high * ratio });
    const context = canvas.current.getContext("2d");
    context.setTransform(ratio * scale, 0, 0, ratio * scale, ratio * x, ratio * y);
    context.font = "12px ui-monospace, 'DejaVu Sans Mono', monospace";
    const isNear = (at, room, offset, most) => (at + room) * scale + offset > 0 && (at - room) * scale + offset < most;
    const isSeen = (place) => place && isNear(place.x, BOX.across, x, wide) && isNear(place.y, BOX.down, y, high);
    const { places } = drawing.value;
    context.strokeStyle = colour("--edge");
    context.lineWidth = Math.max(1.25, 0.7 / scale);
    for (const place of places) if (isSeen(place) || isSeen(place.from)) drawLink(context, place);
    for (const place of places) if (isSeen(place)) drawBox(context, place, scale >= LEGIBLE);
  });

  useEffect(() => size.subscribe(([wide]) => wide && fit(READABLE)), []);
  useEffect(() => {
    const wanted = chosen.value !== null && drawing.value.places.find(({ node }) => stepsOf(node.elements).length);
    if (wanted) view.value = { scale: 1, x: size.value[0] / 2 - wanted.x - BOX.width / 2, y: size.value[1] / 2 - wanted.y };
  }, [chosen.value]);

  const onWheel = (event) => {
    if (!event.ctrlKey && !event.shiftKey && enlarged.value !== "tree") return; // the page scrolls
    event.preventDefault();
    zoom(Math.exp(-(event.deltaY || event.deltaX) / 300), [event.offsetX, event.offsetY]);
  };
  const onPointerMove = ({ buttons, movementX, movementY }) => {
    if (buttons) view.value = { ...view.value, x: view.value.x + movementX, y: view.value.y + movementY };
  };
  const onClick = ({ offsetX, offsetY }) => {
    const { scale, x, y } = view.value;
    const [left, top] = [(offsetX - x) / scale, (offsetY - y) / scale];
    const isHit = (one) => left >= one.x && left <= one.x + BOX.width && top >= one.y && top <= one.y + BOX.height;
    drawing.value.places.filter(isHit).forEach(({ node }) => pick(node));
  };
  return (
    <div class="graph" ref={frame}>
      <canvas ref={canvas} role="img" aria-label={`the tree of ${nodes.value.length} nodes; its outline has the same nodes by name`}
        onWheel={onWheel} onPointerMove={onPointerMove} onClick={onClick} />
      <div class="tools">
        <button aria-label="larger" onClick={() => zoom(1.4)}>+</button>
        <button aria-label="smaller" onClick={() => zoom(1 / 1.4)}>−</button>
        <button onClick={() => fit()}>Fit</button>
      </div>
    </div>
  );
}
