// An image of a frame. One that could not be loaded is asked for again.

import type { JSX } from "preact";
import { useEffect, useState } from "preact/hooks";
import { link } from "../../state/live";

/** Waits between tries while the service answers, milliseconds. */
const WAITS = [2_000, 5_000, 15_000];

export function Picture(props: JSX.IntrinsicElements["img"] & { src: string; lost: JSX.Element }) {
  const { lost, ...image } = props;
  const [tries, setTries] = useState(0);
  const [isLost, setLost] = useState(false);
  const [src, setSrc] = useState(image.src);
  if (src !== image.src) {
    setSrc(image.src);
    setTries(0);
    setLost(false);
  }
  const isLive = link.value === "live";
  useEffect(() => {
    const wait = WAITS[tries];
    if (!isLost || !isLive || wait === undefined) return undefined;
    const timer = setTimeout(() => (setTries(tries + 1), setLost(false)), wait);
    return () => clearTimeout(timer);
  }, [isLost, isLive, tries]);
  // After a break, the service may have them all again.
  useEffect(() => {
    if (isLive) setTries(0);
  }, [isLive]);
  return isLost ? lost : <img key={tries} {...image} onError={() => setLost(true)} />;
}
