(define (problem inspect_it)
  (:domain inspection)
  (:objects
    pipeline - pipeline
    bluerov - robot
    start_robot search_pipeline inspect_pipeline recharge - action
  )
  (:init
    (start_robot_action start_robot)
    (search_pipeline_action search_pipeline)
    (inspect_pipeline_action inspect_pipeline)
    (recharge_action recharge)
    (action_feasible start_robot)
  )
  (:goal (and (pipeline_inspected pipeline)))
)
