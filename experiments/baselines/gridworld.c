/* Exploration episodes the plain way: queues and loops, one robot after another, one thread.
 *
 * The rules `reference` of dc2g_jax, action for action. Grids are bytes, row by row, y growing downward; sets of poses
 * are four grids, one a heading: 0 = +x, 1 = +y, 2 = -x, 3 = -y. Actions are 0 forward, 1 left (heading - 1), 2 right
 * (heading + 1). Everything is planned afresh at every step.
 */

#include <stdint.h>
#include <stdlib.h>
#include <string.h>

enum { ORACLE = 0, FRONTIER = 1, FRONTIER_LAZY = 2 };
enum { FORWARD = 0, LEFT = 1, RIGHT = 2, NO_PLAN = -1 };
enum { NEAREST, NEAREST_SMALLEST, LAZY };
enum { OUT_OF_MEMORY = 1 };

static const int FORWARD_X[4] = {1, 0, -1, 0};
static const int FORWARD_Y[4] = {0, 1, 0, -1};

/* Offsets (dx, dy) from the robot, those of heading k at first[k] to first[k + 1] - 1. */
typedef struct {
    const int32_t *first;
    const int32_t *dx;
    const int32_t *dy;
} Kernel;

typedef struct {
    int x;
    int y;
    int heading;
} Pose;

typedef struct {
    int width;
    int height;
    int cells;
    Kernel sensing;
    Kernel expanding;
    uint8_t *seen;      /* [cells] */
    uint8_t *free;      /* [cells] seen and traversable */
    uint8_t *reachable; /* [cells] */
    uint8_t *targets;   /* [4 cells] */
    uint8_t *found;     /* [4 cells] poses the search has found */
    uint8_t *action;    /* [4 cells] first action of the plan to a pose */
    Pose *queue;        /* [4 cells] */
} Robot;

static int inside(const Robot *robot, int x, int y)
{
    return x >= 0 && x < robot->width && y >= 0 && y < robot->height;
}

/* Index of a pose in a set of poses. */
static int pose_index(const Robot *robot, Pose pose)
{
    return pose.heading * robot->cells + pose.y * robot->width + pose.x;
}

/* The pose after an action. A step forward off the map stays in place. */
static Pose moved(const Robot *robot, Pose pose, int action)
{
    Pose ahead = {pose.x + FORWARD_X[pose.heading], pose.y + FORWARD_Y[pose.heading], pose.heading};
    if (action == FORWARD)
        return inside(robot, ahead.x, ahead.y) ? ahead : pose;
    pose.heading = (pose.heading + (action == LEFT ? 3 : 1)) % 4;
    return pose;
}

/* Add what is seen from a pose. */
static void observe(Robot *robot, const uint8_t *traversable, Pose pose)
{
    const Kernel *kernel = &robot->sensing;
    for (int i = kernel->first[pose.heading]; i < kernel->first[pose.heading + 1]; i++) {
        int x = pose.x + kernel->dx[i], y = pose.y + kernel->dy[i];
        if (inside(robot, x, y)) {
            int cell = y * robot->width + x;
            robot->seen[cell] = 1;
            robot->free[cell] = traversable[cell];
        }
    }
}

/* Flood the free cells connected to the robot's own. */
static void find_reachable(Robot *robot, Pose pose)
{
    int head = 0, tail = 0;
    memset(robot->reachable, 0, (size_t)robot->cells);
    if (!robot->free[pose.y * robot->width + pose.x])
        return;
    robot->reachable[pose.y * robot->width + pose.x] = 1;
    robot->queue[tail++] = pose;
    while (head < tail) {
        Pose current = robot->queue[head++];
        for (int heading = 0; heading < 4; heading++) {
            Pose next = {current.x + FORWARD_X[heading], current.y + FORWARD_Y[heading], heading};
            int cell = next.y * robot->width + next.x;
            if (inside(robot, next.x, next.y) && robot->free[cell] && !robot->reachable[cell]) {
                robot->reachable[cell] = 1;
                robot->queue[tail++] = next;
            }
        }
    }
}

/* Is a cell one that frontier-expanding poses cover: seen, with an unseen neighbor? */
static int wanted(const Robot *robot, int x, int y)
{
    if (!robot->seen[y * robot->width + x])
        return 0;
    for (int k = 0; k < 4; k++) {
        int column = x + FORWARD_X[k], row = y + FORWARD_Y[k];
        if (inside(robot, column, row) && !robot->seen[row * robot->width + column])
            return 1;
    }
    return 0;
}

/* Target the frontier-expanding poses: reachable, not the current one, covering a wanted cell. */
static void target_frontier_expanding(Robot *robot, Pose pose)
{
    const Kernel *kernel = &robot->expanding;
    int count = 0;
    for (int y = 0; y < robot->height; y++)
        for (int x = 0; x < robot->width; x++)
            if (wanted(robot, x, y))
                robot->queue[count++] = (Pose){x, y, 0};
    memset(robot->targets, 0, 4 * (size_t)robot->cells);
    for (int heading = 0; heading < 4; heading++) {
        uint8_t *targets = robot->targets + heading * robot->cells;
        for (int i = kernel->first[heading]; i < kernel->first[heading + 1]; i++) {
            int dx = kernel->dx[i], dy = kernel->dy[i];
            for (int k = 0; k < count; k++) {
                int x = robot->queue[k].x - dx, y = robot->queue[k].y - dy;
                if (inside(robot, x, y) && robot->reachable[y * robot->width + x])
                    targets[y * robot->width + x] = 1;
            }
        }
    }
    robot->targets[pose_index(robot, pose)] = 0;
}

/* Does a pose cover a wanted cell? */
static int covers_wanted(const Robot *robot, Pose pose)
{
    const Kernel *kernel = &robot->expanding;
    for (int i = kernel->first[pose.heading]; i < kernel->first[pose.heading + 1]; i++) {
        int x = pose.x + kernel->dx[i], y = pose.y + kernel->dy[i];
        if (inside(robot, x, y) && wanted(robot, x, y))
            return 1;
    }
    return 0;
}

/* First action of the plan to the nearest target, searched first in, first out; NO_PLAN where there is none.
 *
 * NEAREST: to the target found first. NEAREST_SMALLEST: of the targets equally near, to the one of the smallest index.
 * LAZY: targets are the frontier-expanding poses, and each pose is looked at only when the search comes to it.
 */
static int first_action(Robot *robot, const uint8_t *ground, Pose pose, int choice)
{
    int head = 0, tail = 0, level_end = 1, best = NO_PLAN;
    int root = pose_index(robot, pose);
    memset(robot->found, 0, 4 * (size_t)robot->cells);
    robot->found[root] = 1;
    robot->queue[tail++] = pose;
    while (head < tail) {
        if (head == level_end) {
            if (best != NO_PLAN)
                break;
            level_end = tail;
        }
        Pose current = robot->queue[head++];
        int index = pose_index(robot, current);
        if (choice == LAZY ? index != root && covers_wanted(robot, current) : robot->targets[index]) {
            if (choice != NEAREST_SMALLEST)
                return robot->action[index];
            if (best == NO_PLAN || index < best)
                best = index;
        }
        for (int action = FORWARD; action <= RIGHT; action++) {
            Pose next = moved(robot, current, action);
            int next_index = pose_index(robot, next);
            if (!robot->found[next_index] && ground[next.y * robot->width + next.x]) {
                robot->found[next_index] = 1;
                robot->action[next_index] = index == root ? (uint8_t)action : robot->action[index];
                robot->queue[tail++] = next;
            }
        }
    }
    return best == NO_PLAN ? NO_PLAN : robot->action[best];
}

/* Target the poses on goal cells: all of them, or those on the first cell alone. Returns whether there are any. */
static int target_goals(Robot *robot, const uint8_t *goals, const uint8_t *among, int first_only)
{
    int any = 0;
    memset(robot->targets, 0, 4 * (size_t)robot->cells);
    for (int cell = 0; cell < robot->cells && !(any && first_only); cell++) {
        if (goals[cell] && among[cell]) {
            any = 1;
            for (int heading = 0; heading < 4; heading++)
                robot->targets[heading * robot->cells + cell] = 1;
        }
    }
    return any;
}

/* The next action, or NO_PLAN to give up. */
static int plan(Robot *robot, const uint8_t *traversable, const uint8_t *goals, int planner, Pose pose)
{
    if (planner == ORACLE) {
        target_goals(robot, goals, traversable, 0);
        return first_action(robot, traversable, pose, NEAREST);
    }
    find_reachable(robot, pose);
    if (target_goals(robot, goals, robot->reachable, 1))
        return first_action(robot, robot->free, pose, NEAREST_SMALLEST);
    if (planner == FRONTIER_LAZY)
        return first_action(robot, robot->free, pose, LAZY);
    target_frontier_expanding(robot, pose);
    return first_action(robot, robot->free, pose, NEAREST);
}

/* Run one episode. Writes the actions and returns their number; `success` tells whether a goal was reached. */
static int run_episode(Robot *robot, const uint8_t *traversable, const uint8_t *goals, int planner, Pose pose,
                       int step_limit, int8_t *actions, uint8_t *success)
{
    int steps = 0;
    memset(robot->seen, 0, (size_t)robot->cells);
    memset(robot->free, 0, (size_t)robot->cells);
    observe(robot, traversable, pose);
    while (!goals[pose.y * robot->width + pose.x] && steps < step_limit) {
        int action = plan(robot, traversable, goals, planner, pose);
        if (action == NO_PLAN)
            break;
        pose = moved(robot, pose, action);
        observe(robot, traversable, pose);
        actions[steps++] = (int8_t)action;
    }
    *success = goals[pose.y * robot->width + pose.x];
    return steps;
}

/* Run episodes one after another.
 *
 * traversable, goals: [worlds][height][width]; world: [episodes]; start: [episodes][x, y, heading].
 * Out: steps, success: [episodes]; actions: [episodes][step_limit], what follows the last action is left as it is.
 * Returns 0, or OUT_OF_MEMORY.
 */
int run_episodes(int height, int width, const uint8_t *traversable, const uint8_t *goals, int episodes,
                 const int32_t *world, const int32_t *start, const int32_t *sensing_first, const int32_t *sensing_dx,
                 const int32_t *sensing_dy, const int32_t *expanding_first, const int32_t *expanding_dx,
                 const int32_t *expanding_dy, int planner, int step_limit, int32_t *steps, uint8_t *success,
                 int8_t *actions)
{
    size_t cells = (size_t)height * (size_t)width;
    Robot robot = {.width = width, .height = height, .cells = (int)cells};
    uint8_t *bytes = calloc(cells, 3 + 3 * 4);
    robot.queue = malloc(4 * cells * sizeof *robot.queue);
    if (!bytes || !robot.queue) {
        free(bytes);
        free(robot.queue);
        return OUT_OF_MEMORY;
    }
    robot.sensing = (Kernel){sensing_first, sensing_dx, sensing_dy};
    robot.expanding = (Kernel){expanding_first, expanding_dx, expanding_dy};
    robot.seen = bytes;
    robot.free = bytes + cells;
    robot.reachable = bytes + 2 * cells;
    robot.targets = bytes + 3 * cells;
    robot.found = bytes + 7 * cells;
    robot.action = bytes + 11 * cells;
    for (int i = 0; i < episodes; i++) {
        size_t offset = (size_t)world[i] * cells;
        Pose pose = {start[3 * i], start[3 * i + 1], start[3 * i + 2]};
        steps[i] = run_episode(&robot, traversable + offset, goals + offset, planner, pose, step_limit,
                               actions + (size_t)i * (size_t)step_limit, success + i);
    }
    free(bytes);
    free(robot.queue);
    return 0;
}
