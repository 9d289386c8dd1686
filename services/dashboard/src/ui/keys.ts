// Keys that work on every screen. The screen Keys lists them.

import { useEffect } from "preact/hooks";
import { go } from "../state/route";

export const GOTO = { t: "tonight", f: "farm", r: "record", s: "submit", e: "settings" } as const;

const hours = new Intl.DateTimeFormat("en-GB", { hour: "2-digit", minute: "2-digit" });

/** The time of day. */
export function clock(at: number): string {
  return hours.format(at);
}

/** Whether a key press belongs to a field and not to the page. */
export function isTyping(event: KeyboardEvent): boolean {
  const target = event.target as HTMLElement;
  return (
    event.ctrlKey ||
    event.metaKey ||
    event.altKey ||
    /^(INPUT|SELECT|TEXTAREA)$/.test(target.tagName) ||
    target.isContentEditable
  );
}

export function useKeys(): void {
  useEffect(() => {
    let going = 0;
    const press = (event: KeyboardEvent) => {
      if (isTyping(event) || document.querySelector("dialog[open]")) return;
      if (going > Date.now() - 1500 && event.key in GOTO) {
        going = 0;
        event.preventDefault();
        go([GOTO[event.key as keyof typeof GOTO]]);
        return;
      }
      going = event.key === "g" ? Date.now() : 0;
      if (event.key === "/") {
        const search = document.getElementById("search");
        if (search) {
          event.preventDefault();
          search.focus();
        }
      } else if (event.key === "?") {
        go(["keys"]);
      }
    };
    addEventListener("keydown", press);
    return () => removeEventListener("keydown", press);
  }, []);
}
