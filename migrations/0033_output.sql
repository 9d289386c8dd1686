-- Where a job's images go besides the artefacts. Conventions as in 0001.

-- Pattern of the paths of its images, below the service's output root. NULL: images are artefacts alone.
ALTER TABLE jobs ADD COLUMN output TEXT CHECK (length(output) BETWEEN 1 AND 500);

-- Whether the frame's image is still to be written there, and why that failed last.
ALTER TABLE frames ADD COLUMN output_due INTEGER NOT NULL DEFAULT 0 CHECK (output_due IN (0, 1));
ALTER TABLE frames ADD COLUMN output_error TEXT;
CREATE INDEX frames_output_due ON frames (job_id, frame) WHERE output_due = 1;
