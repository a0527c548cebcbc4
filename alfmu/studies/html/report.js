"use strict";

async function unpacked(text) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const plain = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(plain).text();
}

// Everyone who needs plotly waits for the same one.
let plotly = null;
function library() {
  plotly ??= unpacked(document.getElementById("library").textContent).then((text) => {
    const script = document.createElement("script");
    script.textContent = text;
    document.head.append(script);
    return window.Plotly;
  });
  return plotly;
}

async function drawn(place) {
  const figure = JSON.parse(place.querySelector("script").textContent);
  const Plotly = await library();
  await Plotly.newPlot(place, figure.data, figure.layout, { responsive: true, displaylogo: false });
  place.dataset.drawn = "yes";
}

async function shown(frame) {
  frame.srcdoc = await unpacked(frame.dataset.film);
  frame.removeAttribute("data-film");
}

function failed(place, error) {
  const said = document.createElement("p");
  said.className = "failed";
  said.textContent = `This part of the page cannot be shown: ${error.message}`;
  place.replaceChildren(said);
  throw error;
}

// A part is made when it comes near the window; all of them before the page is printed.
function make(place) {
  watcher.unobserve(place);
  const kind = place.matches(".plot") ? drawn : shown;
  return kind(place).catch((error) => failed(place, error));
}
const watcher = new IntersectionObserver(
  (entries) => entries.filter((e) => e.isIntersecting).forEach((e) => make(e.target)),
  { rootMargin: "400px" },
);
const parts = document.querySelectorAll(".plot, iframe[data-film]");
parts.forEach((place) => watcher.observe(place));
window.addEventListener("beforeprint", () => document.querySelectorAll(".plot:not([data-drawn])").forEach(make));
