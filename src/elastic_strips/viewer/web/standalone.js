(async () => {
  const unpacked = async (name) => {
    const packed = Uint8Array.from(atob(document.getElementById(name).textContent.trim()), (c) => c.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
  };
  for (const name of ["es-meshcat", "es-page"]) {
    const script = document.createElement("script");
    script.textContent = new TextDecoder().decode(await unpacked(name));
    document.body.appendChild(script);
  }
  receive(await unpacked("es-data"));
})();
