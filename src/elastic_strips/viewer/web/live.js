viewer.connect(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/ws`);
viewer.connection.onmessage = (message) => {
  if (typeof message.data === "string") toast(message.data); else receive(new Uint8Array(message.data));
};
viewer.connection.onclose = () => {
  document.title = "(ended) " + document.title;
  toast("the program has ended: this is its last picture");
  ended();
};
