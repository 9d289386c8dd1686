// Short names of the types that `openapi.yaml` defines.

import type { Schemas } from "./client";

export type AccuracyDoc = Schemas["AccuracyDoc"];
export type AccuracyRung = Schemas["AccuracyRung"];
export type AnswersDoc = Schemas["AnswersDoc"];
export type Budget = Schemas["Budget"];
export type BudgetForecast = Schemas["BudgetForecast"];
export type Bundle = Schemas["Bundle"];
export type Confidence = Schemas["Confidence"];
export type Dashboard = Schemas["Dashboard"];
export type DashboardJob = Schemas["DashboardJob"];
export type Event = Schemas["Event"];
export type EventKind = Schemas["EventKind"];
export type Explanation = Schemas["Explanation"];
export type ForecastDoc = Schemas["ForecastDoc"];
export type ForecastHistory = Schemas["ForecastHistory"];
export type FrameRow = Schemas["FrameRow"];
export type FrameStrip = Schemas["FrameStrip"];
export type Job = Schemas["Job"];
export type JobChange = Schemas["JobChange"];
export type JobRequest = Schemas["JobRequest"];
export type JobState = Schemas["JobState"];
export type MoneyForecast = Schemas["MoneyForecast"];
export type Node = Schemas["Node"];
export type NodeChange = Schemas["NodeChange"];
export type NodeState = Schemas["NodeState"];
export type PlanChange = Schemas["PlanChange"];
export type PlanDifference = Schemas["PlanDifference"];
export type PlanEffect = Schemas["PlanEffect"];
export type Quantiles = Schemas["Quantiles"];
export type RenderSettings = Schemas["RenderSettings"];
export type Session = Schemas["Session"];
export type TaskLog = Schemas["TaskLog"];
export type TimelineNode = Schemas["TimelineNode"];
export type TimelineSpan = Schemas["TimelineSpan"];
export type TrackRecord = Schemas["TrackRecord"];

/** The dashboard's document with all that the service of this page always sends. Older ones leave fields out. */
export type Farm = Dashboard &
  Required<Pick<Dashboard, "jobs_open_total" | "node_counts" | "spending">> & {
    counts: Required<Dashboard["counts"]>;
  };

/** The same of what streams tell of the farm. */
export type FarmSummary = Schemas["FarmSummary"] & Pick<Farm, "counts">;
