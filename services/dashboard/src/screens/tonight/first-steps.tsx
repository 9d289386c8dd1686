// An empty farm: the first three things to do.

import type { Farm } from "../../api/types";
import { mayOperate, maySubmit } from "../../state/session";
import { href } from "../../state/route";
import { Mark } from "../../ui/mark";
import { Section } from "../../ui/parts";

export function FirstSteps(props: { farm: Farm }) {
  const nodes = props.farm.counts.nodes;
  const server = location.origin;
  return (
    <Section title="Three things to do first" class="first-steps">
      <ol>
        <li>
          <h3>Add nodes {nodes > 0 && <Mark of="done" word={`done: ${nodes}`} />}</h3>
          <p>
            A node is a machine that renders.{" "}
            {mayOperate.value ? (
              <>
                On the <a href={href(["farm"], { add: "1" })}>Farm</a> screen, “Add a node” makes a one-time
                token and shows the command for that machine.
              </>
            ) : (
              <>An operator adds it on the Farm screen.</>
            )}{" "}
            For a trial on this one:
          </p>
          <pre tabIndex={0}>
            <code>forelight worker --server {server} --token-file farm-data/tokens/worker.token</code>
          </pre>
        </li>
        <li>
          <h3>Get a quote</h3>
          <p>
            {maySubmit.value ? (
              <>
                <a href={href(["submit"])}>Submit a scene</a>: drop its bundle, say which frames and by when.
                You see what it will cost, and how sure that is, before anything is booked. Or in a terminal:
              </>
            ) : (
              <>Somebody with the role submitter or operator submits a scene:</>
            )}
          </p>
          <pre tabIndex={0}>
            <code>forelight submit deploy/scenes/kitchen --frames 0-11 --deadline 2h --hold</code>
          </pre>
        </li>
        <li>
          <h3>Set a budget</h3>
          <p>Then this screen warns before a night costs more, and the farm can stop by itself.</p>
          <pre tabIndex={0}>
            <code>forelight budget set film 250 --per night --warn 80 --drain 100</code>
          </pre>
        </li>
      </ol>
    </Section>
  );
}
