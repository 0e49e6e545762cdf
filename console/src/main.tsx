import "uplot/dist/uPlot.min.css";
import { render } from "preact";
import { App } from "./views/app";
import "./console.css";

render(<App />, document.getElementById("app")!);
