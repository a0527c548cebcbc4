"use strict";
// Common to all films: data, controls, and the instants on both sides of a time.
const film = JSON.parse(document.getElementById("data").textContent);
const { time, speed } = film, [width, height] = film.size;
const first = time[0], last = time[time.length - 1];
const find = (tag) => document.querySelector(tag);
const canvas = find("canvas"), button = find("button"), slider = find("input"), shown = find("output");
const select = find("select");
const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
let now = first, playing = !still && last > first, before = null;

document.documentElement.style.setProperty("--aspect", width / height);
slider.min = first;
slider.max = last;
for (const s of [...new Set([0.1, 0.25, 0.5, 1, 2, 5, 10, speed])].sort((a, b) => a - b)) {
  select.add(new Option(s + " \u00d7", s, s === speed, s === speed));
}

// Return the last instant not after t.
function latest(t) {
  let low = 0, high = time.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (time[middle] <= t) low = middle; else high = middle - 1;
  }
  return low;
}

// Return the instants i and j on both sides of t, and the relative position of t between them.
function around(t) {
  const i = latest(t), j = Math.min(i + 1, time.length - 1);
  return [i, j, j > i ? (t - time[i]) / (time[j] - time[i]) : 0];
}
