// Return the content of an element, compressed by gzip, by its id.

async function bytes(id) {
  const packed = Uint8Array.from(atob(document.getElementById(id).textContent.trim()), (c) => c.charCodeAt(0));
  const plain = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(plain).arrayBuffer());
}

// Run a script of the page.
async function loaded(id) {
  const script = document.createElement("script");
  script.src = URL.createObjectURL(new Blob([await bytes(id)], { type: "text/javascript" }));
  await new Promise((go) => { script.onload = go; document.head.append(script); });
}

