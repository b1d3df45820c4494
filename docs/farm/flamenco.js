// A round of prelight as a Flamenco job type: a task of Flamenco a task of the round. Rendered by `prelight farm template flamenco`; not run on
// a real farm. Put it into the manager's `scripts` folder.
const JOB_TYPE = {
    label: "Prelight round",
    settings: [
        { key: "round", type: "string", required: true, description: "PRELIGHT_ROUND: digest of the round" },
        { key: "tasks", type: "int32", required: true, description: "PRELIGHT_TASKS: tasks of the round" },
        { key: "shards_per_task", type: "int32", required: true, description: "PRELIGHT_SHARDS_PER_TASK: shards of each" },
    ],
};

function compileJob(job) {
    for (let index = 0; index < job.settings.tasks; index++) {
        const task = author.Task(`bake-${index}`, "bake");
        task.addCommand(author.Command("exec", {
            exe: "prelight",
            args: [
                "shard", "run",
                "--store", "/shared/bakes",
                "--round", job.settings.round,
                "--index", `${index}`,
                "--shards-per-task", `${job.settings.shards_per_task}`,
                "--jobs", "4",
                "--progress", "never",
            ],
        }));
        job.addTask(task);
    }
}
