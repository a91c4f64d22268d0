viewer.connect(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/ws`);
viewer.connection.onmessage = (message) => receive(new Uint8Array(message.data));
viewer.connection.onclose = () => { document.title = "(ended) " + document.title; };
