"use strict";
// What every film begins with: its data, its controls, the instants on both sides of a time.
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

// The last instant not after t.
function latest(t) {
  let low = 0, high = time.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (time[middle] <= t) low = middle; else high = middle - 1;
  }
  return low;
}

// The instants i and j on both sides of t, and how far t is from the one to the other.
function around(t) {
  const i = latest(t), j = Math.min(i + 1, time.length - 1);
  return [i, j, j > i ? (t - time[i]) / (time[j] - time[i]) : 0];
}

// Where labels stand that keep off each other, off the pins [x, y, radius] and inside the picture: the rules of
// surface.py (`placed`). A box is [x, y, half its width, half its height]; pins move nothing but labels.
function apart(boxes, pins, size) {
  for (let pass = 0; pass < 60; pass++) {
    let moved = false;
    boxes.forEach((box, i) => {
      for (const other of boxes.slice(i + 1)) {
        const over = box[2] + other[2] - Math.abs(box[0] - other[0]);
        const under = box[3] + other[3] - Math.abs(box[1] - other[1]);
        if (over <= 0 || under <= 0) continue;
        const k = over < under ? 0 : 1, way = Math.min(over, under) / 2 + 0.01;
        const sign = box[k] - other[k] >= 0 ? 1 : -1;
        box[k] += sign * way;
        other[k] -= sign * way;
        moved = true;
      }
      for (const [x, y, r] of pins) {
        const over = box[2] + r - Math.abs(box[0] - x), under = box[3] + r - Math.abs(box[1] - y);
        if (over <= 0 || under <= 0) continue;
        const k = over < under ? 0 : 1, way = Math.min(over, under) + 0.01;
        box[k] += box[k] >= [x, y][k] ? way : -way;
        moved = true;
      }
      for (const k of [0, 1]) box[k] = Math.min(Math.max(box[k], box[2 + k]), Math.max(size[k] - box[2 + k], box[2 + k]));
    });
    if (!moved) break;
  }
  return boxes;
}

// A text about its middle, with a rim, on a canvas whose y points upwards.
function lettered(pen, text, x, y, size, color) {
  pen.font = `${size}px {{fonts}}`;
  pen.save();
  pen.translate(x, y);
  pen.scale(1, -1);
  pen.lineWidth = 2 * size / 7;
  pen.strokeStyle = "{{background}}";
  pen.fillStyle = color;
  pen.strokeText(text, 0, 0);
  pen.fillText(text, 0, 0);
  pen.restore();
}
