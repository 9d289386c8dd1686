// The list of keys.

import { useEffect } from "preact/hooks";
import { titled } from "../state/tab";

const KEYS: [keys: string[], does: string][] = [
  [["g", "t"], "go to Tonight"],
  [["g", "f"], "go to Farm"],
  [["g", "r"], "go to Record"],
  [["g", "s"], "go to Submit"],
  [["g", "e"], "go to Settings"],
  [["/"], "search on this screen"],
  [["?"], "this list"],
  [["←", "→"], "on a frame strip: the frame before, the next frame; with Shift, select"],
  [["↑", "↓"], "on a frame strip: a row up, a row down"],
  [["Home", "End"], "on a frame strip: first frame, last frame"],
  [["Enter"], "on a frame strip: show this frame's images"],
  [[",", "."], "on a job: images of the frame before, of the next frame"],
  [["Escape"], "clear the selection; close a question"],
  [["+", "−"], "on the farm's chart and on images: zoom"],
  [["←", "→"], "on the farm's chart: earlier, later"],
  [["0"], "on the farm's chart: tonight; on images: the whole image"],
  [["←", "→", "↑", "↓"], "on images: move the image"],
  [
    ["Shift", "← → ↑ ↓"],
    "on images: a crosshair that tells object, material and cost under it; Escape ends it",
  ],
  [["Shift", "← →"], "on the farm's chart: the span before, the next span of a node"],
  [["Shift", "↑ ↓"], "on the farm's chart: the node above, the node below"],
  [["Enter"], "on the farm's chart: hold the span that is told, and again: its job; Escape lets go"],
];

export function KeysScreen() {
  useEffect(() => titled("Keys"), []);
  return (
    <div class="alone">
      <h1>Keys</h1>
      <table class="numbers keys">
        <thead>
          <tr>
            <th scope="col">Press</th>
            <th scope="col">To</th>
          </tr>
        </thead>
        <tbody>
          {KEYS.map(([keys, does]) => (
            <tr key={keys.join() + does}>
              <td>
                {keys.map((key, at) => (
                  <>
                    {at > 0 && " "}
                    <kbd>{key}</kbd>
                  </>
                ))}
              </td>
              <td>{does}</td>
            </tr>
          ))}
        </tbody>
      </table>
    </div>
  );
}
