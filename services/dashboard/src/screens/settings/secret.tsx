// A secret that is shown once.

import type { ComponentChildren } from "preact";
import { useState } from "preact/hooks";
import { Dialog } from "../../ui/dialog";

function Secret(props: { text: string }) {
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

/** Shows a secret until whoever made it has kept it. */
export function SecretDialog(props: {
  title: string;
  secret: string;
  close: () => void;
  children?: ComponentChildren;
}) {
  return (
    <Dialog title={props.title} close={props.close}>
      {props.children}
      <Secret text={props.secret} />
      <div class="buttons">
        <button type="button" onClick={props.close}>
          I have kept it
        </button>
      </div>
    </Dialog>
  );
}
