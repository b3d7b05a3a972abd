// The WebSocket to the server: messages as JSON, frames as described by `djpt.apps.viewer.session.packed`.

const RETRY = 1000; // ms

export function connect({ onFrame, onMessage, onState }) {
  let socket = null;
  let number = 0;

  function open() {
    // Beside the page, whose address has the secret.
    const address = new URL("socket", location.href);
    address.protocol = location.protocol === "https:" ? "wss:" : "ws:";
    socket = new WebSocket(address);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => onState("connected");
    socket.onmessage = ({ data }) => {
      if (typeof data === "string") onMessage(JSON.parse(data));
      else onFrame(frame(data));
    };
    socket.onclose = () => {
      onState("no connection to djpt, retrying; if djpt view is restarted, open its new address");
      setTimeout(open, RETRY);
    };
  }

  open();
  return {
    // Frames say which message they answer, by its number.
    send(message) {
      number += 1;
      if (socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify({ ...message, number }));
      return number;
    },
  };
}

function frame(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  return { ...header, halves: new Uint16Array(buffer, 4 + length) };
}
