// The clock of a film and its controls. The script of the picture stands before this one: `draw()` shows the time
// `now`, `resized()` adapts to the size of the canvas, `film` has the data of the page.

function showTime() {
  slider.value = now;
  shown.value = `${now.toFixed(2)} s / ${last.toFixed(2)} s`;
  button.classList.toggle("playing", playing);
}

function tick(stamp) {
  if (playing && before !== null) {
    now += Math.min(stamp - before, 100) / 1000 * Number(select.value);
    if (now > last) now = first + (now - last) % (last - first);
    draw();
  }
  before = stamp;
  requestAnimationFrame(tick);
}

function toggle() {
  playing = !playing && last > first;
  draw();
}

button.addEventListener("click", toggle);
slider.addEventListener("input", () => { now = Number(slider.value); playing = false; draw(); });
document.addEventListener("keydown", (event) => {
  if (event.code === "Space" && event.target !== button) { event.preventDefault(); toggle(); }
});
new ResizeObserver(() => { resized(); draw(); }).observe(canvas);
requestAnimationFrame(tick);
