// A chart over the last minute. Its values are in words next to it.

import { clock } from "../data/bytes.js";
import { WINDOW_S } from "../data/messages.js";
import { h } from "./dom.js";

// The plot in its own units: a second is one wide, and 100 is its height.
const WIDTH = WINDOW_S - 1;
const HEIGHT = 100;

/** @typedef {{ name: "first" | "second", values: (number | undefined)[] }} Series */

/**
 * The smallest of 1, 2, 5, 10, 20 … that is not below.
 * @param {number} value
 */
function roundUp(value) {
  const unit = 10 ** Math.floor(Math.log10(value));
  return [1, 2, 5, 10].map((step) => step * unit).find((step) => step >= value) ?? value;
}

/**
 * A line through the values that there are; one alone is a point.
 * @param {(number | undefined)[]} values the newest one last
 * @param {number} top
 */
function line(values, top) {
  const from = WIDTH - (values.length - 1);
  const points = values.flatMap((value, at) => (value === undefined ? [] : [`${from + at} ${(HEIGHT * (1 - value / top)).toFixed(2)}`]));
  return points.length === 1 ? `M${points[0]}h0` : points.length ? `M${points.join("L")}` : "";
}

/**
 * @param {string} label
 * @param {string} unit
 * @param {Series[]} series
 * @param {number} end the newest second, since 1970
 */
export function chart(label, unit, series, end) {
  const most = Math.max(0, ...series.flatMap(({ values }) => values.map((value) => value ?? 0)));
  const top = roundUp(Math.max(most, 1));
  const levels = [top, top / 2, 0];
  const times = [end - WIDTH, end - WIDTH / 2, end];
  return h(
    "div.chart",
    { role: "img", "aria-label": label },
    h("div.levels", levels.map((level) => h("span", `${level} ${unit}`))),
    h(
      "svg",
      { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, preserveAspectRatio: "none" },
      h("path.grid", { d: [0, HEIGHT / 2, HEIGHT].map((y) => `M0 ${y}H${WIDTH}`).join("") }),
      series.map(({ name, values }) => h(`path.line.${name}`, { d: line(values, top) })),
    ),
    h("div.times", times.map((time) => h("span", clock(time * 1e6)))),
  );
}
