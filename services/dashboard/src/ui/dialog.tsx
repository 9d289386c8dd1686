// A modal question. The browser's own dialog keeps the focus inside and closes on Escape.

import type { ComponentChildren } from "preact";
import { useEffect, useId, useRef, useState } from "preact/hooks";
import { asError } from "./resource";
import { Trouble } from "./parts";

export function Dialog(props: {
  title: string;
  close: () => void;
  children: ComponentChildren;
  wide?: boolean;
}) {
  const element = useRef<HTMLDialogElement>(null);
  const id = useId();
  useEffect(() => {
    const before = document.activeElement;
    element.current?.showModal();
    return () => {
      if (before instanceof HTMLElement) before.focus();
    };
  }, []);
  return (
    <dialog
      ref={element}
      aria-labelledby={id}
      class={props.wide ? "wide" : ""}
      onClose={props.close}
      onClick={(event) => event.target === element.current && element.current?.close()}
    >
      <div class="dialog-body">
        <h2 id={id}>{props.title}</h2>
        {props.children}
      </div>
    </dialog>
  );
}

/** A dialog that does one thing, after it has said what that means. */
export function Confirm(props: {
  title: string;
  /** The word on the button, such as `Cancel the job`. */
  act: string;
  danger?: boolean;
  /** Whether the button can be pressed yet. */
  ready?: boolean;
  run: () => Promise<unknown>;
  close: () => void;
  children?: ComponentChildren;
  wide?: boolean;
}) {
  const [state, setState] = useState<{ busy: boolean; error: Error | null }>({ busy: false, error: null });
  const run = async (event: Event) => {
    event.preventDefault();
    setState({ busy: true, error: null });
    try {
      await props.run();
      props.close();
    } catch (error) {
      setState({ busy: false, error: asError(error) });
    }
  };
  return (
    <Dialog title={props.title} close={props.close} wide={props.wide ?? false}>
      <form onSubmit={run}>
        {props.children}
        {state.error && <Trouble error={state.error} />}
        <div class="buttons">
          <button
            type="submit"
            class={props.danger ? "danger" : "primary"}
            disabled={state.busy || props.ready === false}
          >
            {state.busy ? "Asking the service…" : props.act}
          </button>
          <button type="button" onClick={props.close}>
            Leave it
          </button>
        </div>
      </form>
    </Dialog>
  );
}
