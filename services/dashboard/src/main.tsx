import "./styles/base.css";
import "./styles/parts.css";
import "./styles/tonight.css";
import { render } from "preact";
import { App } from "./app";
import { tellTab } from "./state/tab";

render(<App />, document.getElementById("page")!);
tellTab();
