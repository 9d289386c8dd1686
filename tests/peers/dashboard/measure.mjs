// How the browser draws and what it keeps, for tests and measurements of large farms.

/** Runs something, and returns the times between the frames that the browser drew meanwhile, sorted. */
export async function drawn(view, run) {
  await view.evaluate(() => {
    window.times = [];
    let before = performance.now();
    const tick = (at) => {
      window.times.push(at - before);
      before = at;
      window.ticking = requestAnimationFrame(tick);
    };
    window.ticking = requestAnimationFrame(tick);
  });
  await run();
  const times = await view.evaluate(() => (cancelAnimationFrame(window.ticking), window.times.slice(1)));
  return times.sort((a, b) => a - b);
}

/** Frames in words: how many, their median, and the slowest. */
export function frames(times) {
  const at = (share) => times[Math.floor((times.length - 1) * share)].toFixed(0);
  return `${times.length} frames, median ${at(0.5)} ms, slowest ${at(1)} ms`;
}

/** Scrolls Tonight, and says how long its frames took. */
export async function scrollTonight(view) {
  await view.mouse.move(600, 600);
  return await drawn(view, async () => {
    for (let turn = 0; turn < 40; turn++) await view.mouse.wheel(0, 400);
    await view.waitForTimeout(300);
  });
}

/** Scrolls the farm's chart. */
export async function scrollChart(view) {
  await view.mouse.move(800, 600);
  return await drawn(view, async () => {
    for (let turn = 0; turn < 60; turn++) await view.mouse.wheel(0, 300);
    await view.waitForTimeout(300);
  });
}

/** Zooms the farm's chart in and out. */
export async function zoomChart(view) {
  return await drawn(view, async () => {
    await view.keyboard.down("Control");
    for (let turn = 0; turn < 30; turn++) await view.mouse.wheel(0, turn < 15 ? -80 : 80);
    await view.keyboard.up("Control");
    await view.waitForTimeout(300);
  });
}

/** What the tab keeps, in bytes, as the browser counts it: scripts, elements, and buffers. */
export async function memory(view) {
  const session = await view.context().newCDPSession(view);
  await session.send("HeapProfiler.collectGarbage");
  const usage = await session.send("Runtime.getHeapUsage");
  await session.detach();
  return usage.usedSize + (usage.embedderHeapUsedSize ?? 0) + (usage.backingStorageSize ?? 0);
}
