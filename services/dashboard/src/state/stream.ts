// A stream of events of the service. After a break it goes on behind the last event that was seen, so nothing is
// missed. There is none while the tab is hidden for long: browsers allow six connections to a service.

import type { Event } from "../api/types";

const HIDDEN_FOR = 20_000;
const RETRY = [1_000, 2_000, 4_000];

export interface StreamOptions {
  /** The address of the events behind one, or of those that the service begins with. */
  address: (after: number | null) => string;
  kinds: readonly string[];
  take: (event: Event) => void;
  /** What is called with the data of messages that are no events, by their names. */
  others?: Readonly<Record<string, (data: string) => void>>;
  opened: () => void;
  /** It tries again by itself. `tries` counts the breaks since it was last open, from 0. */
  broke: (tries: number) => void;
  /** Whether the service ends the stream when there is nothing more to come. Then it answers 204. */
  ends?: boolean;
}

export interface Stream {
  /** Begins behind this event, or leaves out what comes before. Only moves forward. */
  after: (id: number) => void;
  /** Connects anew, at once. */
  connect: () => void;
  close: () => void;
}

export function openStream(options: StreamOptions): Stream {
  let source: EventSource | null = null;
  let lastId: number | null = null;
  let tries = 0;
  let retry: ReturnType<typeof setTimeout> | undefined;
  let hide: ReturnType<typeof setTimeout> | undefined;
  let closed = false;

  const disconnect = () => {
    clearTimeout(retry);
    source?.close();
    source = null;
  };
  const take = (message: MessageEvent<string>) => {
    const event = JSON.parse(message.data) as Event;
    if (lastId !== null && event.id <= lastId) return;
    lastId = event.id;
    options.take(event);
  };
  const connect = () => {
    if (closed) return;
    disconnect();
    const stream = new EventSource(options.address(lastId));
    source = stream;
    stream.onopen = () => {
      tries = 0;
      options.opened();
    };
    // The browser would retry by itself, but with an address that holds an old event, and not after an error
    // status.
    stream.onerror = () => {
      if (source !== stream) return;
      disconnect();
      options.broke(tries);
      retry = setTimeout(() => void again(), RETRY[Math.min(tries++, RETRY.length - 1)]);
    };
    for (const kind of options.kinds) stream.addEventListener(kind, take);
    for (const [name, other] of Object.entries(options.others ?? {})) {
      stream.addEventListener(name, (message: MessageEvent<string>) => other(message.data));
    }
    // Tabs that were opened in the background were never shown.
    clearTimeout(hide);
    if (document.visibilityState === "hidden") hide = setTimeout(disconnect, HIDDEN_FOR);
  };
  const again = async () => {
    if (options.ends && (await hasEnded(options.address(lastId)))) close();
    else connect();
  };
  const seen = () => {
    clearTimeout(hide);
    if (document.visibilityState === "hidden") hide = setTimeout(disconnect, HIDDEN_FOR);
    else if (!source || source.readyState === EventSource.CLOSED) connect();
  };
  const close = () => {
    closed = true;
    document.removeEventListener("visibilitychange", seen);
    removeEventListener("online", connect);
    clearTimeout(hide);
    disconnect();
  };
  document.addEventListener("visibilitychange", seen);
  addEventListener("online", connect);
  return { after: (id) => (lastId = Math.max(id, lastId ?? id)), connect, close };
}

/** Scripts are not told which status ended a stream, so it is asked for. */
async function hasEnded(address: string): Promise<boolean> {
  try {
    return (await fetch(address, { method: "HEAD", credentials: "same-origin" })).status === 204;
  } catch {
    return false;
  }
}
