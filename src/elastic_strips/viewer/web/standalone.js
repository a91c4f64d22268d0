(async () => {
  const packed = Uint8Array.from(atob(byId("es-data").textContent.trim()), (c) => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  receive(new Uint8Array(await new Response(stream).arrayBuffer()));
})();
