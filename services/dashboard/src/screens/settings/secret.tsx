// A secret that is shown once.

import { useState } from "preact/hooks";

export function Secret(props: { text: string }) {
  const [copied, setCopied] = useState(false);
  // Without TLS, browsers let no page write to the clipboard.
  const copy =
    "clipboard" in navigator ? () => void navigator.clipboard.writeText(props.text).then(done) : null;
  const done = () => setCopied(true);
  return (
    <>
      <p>It is shown this once. Keep it where only its owner reads it.</p>
      <pre tabIndex={0} class="secret">
        <code>{props.text}</code>
      </pre>
      {copy && (
        <button type="button" onClick={copy}>
          {copied ? "Copied" : "Copy"}
        </button>
      )}
    </>
  );
}
