"use strict";
const names = { controlled: "with access control", open: "without: both drive",
  preempted: "preemption and emergency stop", delayed: "over a delayed link" };
const drivers = ["nobody may drive", "Salma drives", "Farhad drives", "both drive"];
const colors = ["#6e6e6e", "#0072b2", "#d55e00", "#96468c"];
const canvas = document.getElementById("arena"), pen = canvas.getContext("2d");
const choice = document.getElementById("run"), button = document.getElementById("play");
const slider = document.getElementById("time"), clock = document.getElementById("clock");
const scale = canvas.width / 8;
let run = runs[0], now = 0, playing = true, before = performance.now();

runs.forEach((each, index) => choice.add(new Option(names[each.name], index)));
choice.onchange = () => { run = runs[choice.value]; now = 0; };
button.onclick = () => { playing = !playing; button.textContent = playing ? "pause" : "play"; };
slider.oninput = () => { now = slider.value / 1000 * end(); };

function end() { return run.frames.length ? run.frames[run.frames.length - 1][0] : 0; }
function x(value) { return canvas.width / 2 + value * scale; }
function y(value) { return canvas.height / 2 - value * scale; }

function line(points, color, width, dash) {
  pen.strokeStyle = color; pen.lineWidth = width; pen.setLineDash(dash || []);
  pen.beginPath();
  points.forEach(([px, py], index) => index ? pen.lineTo(x(px), y(py)) : pen.moveTo(x(px), y(py)));
  pen.stroke(); pen.setLineDash([]);
}

function draw() {
  pen.clearRect(0, 0, canvas.width, canvas.height);
  pen.strokeStyle = "#eee"; pen.lineWidth = 1;
  for (let metre = -4; metre <= 4; metre++) {
    line([[metre, -4.5], [metre, 4.5]], "#eee", 1); line([[-4, metre], [4, metre]], "#eee", 1);
  }
  line([run.start, ...run.a], colors[1] + "88", 2, [7, 6]);
  line([run.start, ...run.b], colors[2] + "88", 2, [7, 6]);
  const past = run.frames.filter(frame => frame[0] <= now);
  for (let index = 1; index < past.length; index++) {
    line([past[index - 1].slice(1, 3), past[index].slice(1, 3)], colors[past[index][4]], 3);
  }
  pen.font = "15px system-ui, sans-serif";
  const reached = run.reached.filter(each => each[0] <= now).map(each => each[1]);
  [["A", run.a, 1], ["B", run.b, 2]].forEach(([letter, points, color]) => points.forEach(([px, py], index) => {
    const name = letter + (index + 1);
    pen.beginPath(); pen.arc(x(px), y(py), 7, 0, 7); pen.lineWidth = 2; pen.strokeStyle = pen.fillStyle = colors[color];
    if (reached.includes(name)) pen.fill(); else pen.stroke();
    pen.fillText(name, x(px) + 12, y(py) + 5);
  }));
  const frame = past[past.length - 1] || run.frames[0];
  if (frame) {
    const [, px, py, yaw, driver] = frame;
    pen.beginPath(); pen.arc(x(px), y(py), 0.171 * scale, 0, 7);
    pen.fillStyle = colors[driver] + "44"; pen.fill(); pen.strokeStyle = colors[driver]; pen.lineWidth = 2; pen.stroke();
    line([[px, py], [px + 0.171 * Math.cos(yaw), py + 0.171 * Math.sin(yaw)]], colors[driver], 3);
    clock.textContent = now.toFixed(1) + " s, " + drivers[driver];
  }
}

function step(at) {
  if (playing) now += (at - before) / 1000;
  before = at;
  if (now > end()) now = playing ? 0 : end();
  slider.value = end() ? now / end() * 1000 : 0;
  draw();
  requestAnimationFrame(step);
}
requestAnimationFrame(step);
