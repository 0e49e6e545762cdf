// A chart over the last minute that moves. What it shows stands in words beside it.

import type { JSX } from "preact";
import { useEffect, useRef } from "preact/hooks";
import uPlot from "uplot";
import { WINDOW_S } from "../messages";

export interface Series {
  label: string;
  color: string;
  dash?: number[];
}

const HEIGHT = 150;

const style = (name: string): string => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

export function Chart({ label, unit, series, data }: { label: string; unit: string; series: Series[]; data: uPlot.AlignedData }): JSX.Element {
  const place = useRef<HTMLDivElement>(null);
  const plot = useRef<uPlot>();
  useEffect(() => {
    const host = place.current!;
    const axis = { stroke: style("--dim"), grid: { stroke: style("--line"), width: 1 }, ticks: { show: false }, font: "12px system-ui" };
    const made = new uPlot(
      {
        width: host.clientWidth || 300,
        height: HEIGHT,
        legend: { show: false },
        cursor: { show: false },
        scales: { x: { time: true, range: (_, __, max) => [max - WINDOW_S + 1, max] }, y: { range: (_, __, max) => [0, Math.max(max ?? 0, 1) * 1.1] } },
        axes: [
          { ...axis, values: (_, times) => times.map((time) => new Date(time * 1000).toLocaleTimeString(undefined, { hour12: false, minute: "2-digit", second: "2-digit" })) },
          { ...axis, size: 56, values: (_, values) => values.map((value) => `${value} ${unit}`) },
        ],
        series: [{}, ...series.map(({ label: name, color, dash }) => ({ label: name, stroke: style(color), width: 2, dash, spanGaps: true, points: { show: true, size: 4 } }))],
      },
      data,
      host,
    );
    plot.current = made;
    const resized = new ResizeObserver(() => host.clientWidth && made.setSize({ width: host.clientWidth, height: HEIGHT }));
    resized.observe(host);
    return () => {
      resized.disconnect();
      made.destroy();
    };
  }, []);
  useEffect(() => plot.current?.setData(data), [data]);
  return <div ref={place} class="chart" role="img" aria-label={label} />;
}
