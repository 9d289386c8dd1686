// A modal question. The browser's own dialog keeps the focus inside and closes on Escape.

import type { ComponentChildren } from "preact";
import { signal } from "@preact/signals";
import { useEffect, useId, useRef, useState } from "preact/hooks";
import { asError } from "./resource";
import { Act, Trouble } from "./parts";

/** What failed after its question was closed, and why. */
export const failedLate = signal<{ title: string; error: Error } | null>(null);

export function Dialog(props: {
  title: string;
  close: () => void;
  children: ComponentChildren;
  wide?: boolean;
}) {
  const element = useRef<HTMLDialogElement>(null);
  const id = useId();
  // A drag that ends outside does not close the dialog.
  const pressed = useRef<EventTarget | null>(null);
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
      onPointerDown={(event) => (pressed.current = event.target)}
      onClick={(event) => {
        const isOutside = (target: EventTarget | null) => target !== null && target === element.current;
        if (isOutside(event.target) && isOutside(pressed.current)) element.current?.close();
      }}
    >
      <div class="dialog-body">
        <h2 id={id}>{props.title}</h2>
        {props.children}
      </div>
    </dialog>
  );
}

/** A dialog that does one thing, after it has said what that means. */
export function Confirm<T>(props: {
  title: string;
  /** The word on the button, such as `Cancel the job`. */
  act: string;
  danger?: boolean;
  /** Whether the button can be pressed yet. */
  ready?: boolean;
  run: () => Promise<T>;
  /** Is called with the answer of `run`, unless the question was closed before. */
  next?: (answer: T) => void;
  close: () => void;
  children?: ComponentChildren;
  wide?: boolean;
}) {
  const [state, setState] = useState<{ busy: boolean; error: Error | null }>({ busy: false, error: null });
  const isOpen = useRef(true);
  useEffect(() => () => void (isOpen.current = false), []);
  const run = async (event: Event) => {
    event.preventDefault();
    setState({ busy: true, error: null });
    try {
      const answer = await props.run();
      // Another question may be open by now.
      if (!isOpen.current) return;
      props.close();
      props.next?.(answer);
    } catch (error) {
      if (isOpen.current) setState({ busy: false, error: asError(error) });
      else failedLate.value = { title: props.title, error: asError(error) };
    }
  };
  return (
    <Dialog title={props.title} close={props.close} wide={props.wide ?? false}>
      <form onSubmit={run}>
        {props.children}
        {state.error && <Trouble error={state.error} />}
        <div class="buttons">
          <Act
            type="submit"
            class={props.danger ? "danger" : "primary"}
            busy={state.busy}
            disabled={!state.busy && props.ready === false}
          >
            {state.busy ? "Asking the service…" : props.act}
          </Act>
          <button type="button" onClick={props.close}>
            {state.busy ? "Close" : "Leave it"}
          </button>
          {state.busy && <span class="muted">You can close this. The request continues.</span>}
        </div>
      </form>
    </Dialog>
  );
}
